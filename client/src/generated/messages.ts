// Generated from src/keypose/studio/messages.py by `python -m keypose.studio.typescript`. Do not edit.

export const PROTOCOL = 1;

/** An array in the body of the container: bytes ``offset`` to ``offset + bytes``, row-major. */
export interface ArrayRef {
  offset: number;
  bytes: number;
  element: "float32" | "float64" | "uint8" | "uint16" | "uint32" | "int32";
  shape: number[];
}

/** Joints, parents before children; rest translations (J, 3), rotations (J, 4) wxyz, scales (J, 3). */
export interface SkeletonData {
  names: string[];
  parents: ArrayRef;
  translations: ArrayRef;
  rotations: ArrayRef;
  scales: ArrayRef;
  end_joints: number[];
  end_offsets: ArrayRef;
}

/** An encoded picture, as the file held it. */
export interface PictureData {
  name: string;
  mime_type: string;
  bytes: ArrayRef;
}

/** A surface; colours are linear. */
export interface MaterialData {
  name: string;
  base_color: number[];
  metallic: number;
  roughness: number;
  emissive: number[];
  image: number | null;
  alpha_mode: string;
  alpha_cutoff: number;
  double_sided: boolean;
  unlit: boolean;
}

/** Palette (P,), inverse bind matrices (P, 4, 4), four influences per vertex (V, 4) into the palette. */
export interface SkinData {
  palette: ArrayRef;
  joint_from_mesh: ArrayRef;
  joints: ArrayRef;
  weights: ArrayRef;
}

/** Sparse delta targets; target m moves ``vertices[starts[m]:starts[m + 1]]`` and is driven by ``channels[m]``. */
export interface MorphData {
  channels: ArrayRef;
  starts: ArrayRef;
  vertices: ArrayRef;
  position_deltas: ArrayRef;
  normal_deltas: ArrayRef | null;
}

/** One mesh: skinned, or bound to one joint. */
export interface PartData {
  name: string;
  material: MaterialData;
  positions: ArrayRef;
  triangles: ArrayRef;
  normals: ArrayRef | null;
  uvs: ArrayRef | null;
  colors: ArrayRef | null;
  skin: SkinData | null;
  joint: number | null;
  morphs: MorphData | null;
}

/** A skeleton with its parts and morph channels. */
export interface CharacterData {
  name: string;
  skeleton: SkeletonData;
  parts: PartData[];
  morph_names: string[];
  rest_morph_weights: ArrayRef;
  roles: Record<string, number>;
}

/** Keyframes of one property; the client evaluates them exactly as `keypose.evaluate.sample_curve` does. */
export interface CurveData {
  target: string;
  property: "translation" | "rotation" | "scale" | "weight";
  times: ArrayRef;
  values: ArrayRef;
  modes: ArrayRef;
  in_tangents: ArrayRef | null;
  out_tangents: ArrayRef | null;
  before: string;
  after: string;
}

/** Sparse animation: curves. */
export interface ClipData {
  kind: "clip";
  name: string;
  start_s: number;
  duration_s: number;
  rate_hz: number | null;
  curves: CurveData[];
}

/** Dense animation: arrays of T frames; an array that does not change is sent once, with one frame. */
export interface MotionData {
  kind: "motion";
  name: string;
  start_s: number;
  duration_s: number;
  rate_hz: number;
  frames: number;
  joint_names: string[];
  translations: ArrayRef;
  rotations: ArrayRef;
  scales: ArrayRef;
  morph_names: string[];
  morph_weights: ArrayRef | null;
}

/** All that the browser needs of one opened file; the header of ``GET api/scenes/{id}``. */
export interface SceneData {
  type: "scene";
  id: string;
  name: string;
  format: string;
  unit_m: number;
  up: string;
  notes: string[];
  images: PictureData[];
  characters: CharacterData[];
  animations: (ClipData | MotionData)[];
}

/** A scene that can be fetched, and how many bytes it is. */
export interface SceneEntry {
  id: string;
  name: string;
  bytes: number;
}

/** First message of a connection: what is open now. */
export interface Hello {
  type: "hello";
  protocol: number;
  version: string;
  upload_limit_bytes: number;
  scenes: SceneEntry[];
  expected: number;
}

/** A scene was opened. */
export interface SceneReady {
  type: "scene_ready";
  scene: SceneEntry;
}

/** A scene was closed. */
export interface SceneClosed {
  type: "scene_closed";
  id: string;
}

/** How far a job is; ``fraction`` is None where it cannot be known. A newer one replaces an undelivered older one. */
export interface Progress {
  type: "progress";
  job: string;
  label: string;
  fraction: number | null;
  done: boolean;
}

/** Something went wrong that a person must read. */
export interface Failure {
  type: "failure";
  title: string;
  message: string;
}

/** Something a person may want to know. */
export interface Notice {
  type: "notice";
  title: string;
  message: string;
}

export type ServerMessage = Hello | SceneReady | SceneClosed | Progress | Failure | Notice;

/** A server message and its number; the browser acknowledges the number. */
export interface Envelope {
  sequence: number;
  message: Hello | SceneReady | SceneClosed | Progress | Failure | Notice;
}

/** All messages up to ``sequence`` were handled; the server may send newer ones. */
export interface Acknowledge {
  type: "acknowledge";
  sequence: number;
}

/** Forget a scene. */
export interface CloseScene {
  type: "close_scene";
  id: string;
}

/** Open a built-in character or performance by its name. */
export interface OpenSample {
  type: "open_sample";
  name: string;
}

export type ClientMessage = Acknowledge | CloseScene | OpenSample;

/** One dropped file: its name (with folders, where a folder was dropped) and bytes. */
export interface UploadFile {
  name: string;
  bytes: ArrayRef;
}

/** Header of ``POST api/scenes``: files dropped together. */
export interface Upload {
  type: "upload";
  files: UploadFile[];
}

/** Answer to an upload: what was opened, and one line for each file that was not. */
export interface UploadResult {
  opened: SceneEntry[];
  errors: string[];
}
