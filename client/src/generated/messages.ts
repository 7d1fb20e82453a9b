// Generated from src/keypose/studio/messages.py by `python -m keypose.studio.typescript`. Do not edit.

export const PROTOCOL = 2;

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
  property: "translation" | "rotation" | "euler" | "scale" | "weight" | "value";
  component: number | null;
  kind: "scalar" | "vector" | "rotation" | "euler" | "color" | "boolean";
  times: ArrayRef;
  values: ArrayRef;
  modes: ArrayRef;
  in_tangents: ArrayRef | null;
  out_tangents: ArrayRef | null;
  in_handles: ArrayRef | null;
  out_handles: ArrayRef | null;
  types: ArrayRef | null;
  before: string;
  after: string;
}

/** Sparse animation: curves, and the order of Euler angles of the joints that have another than `EULER_ORDER`. */
export interface ClipData {
  kind: "clip";
  name: string;
  start_s: number;
  duration_s: number;
  rate_hz: number | null;
  curves: CurveData[];
  euler_orders: Record<string, string>;
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

/** An animation graph that can be played. */
export interface GraphEntry {
  id: string;
  name: string;
}

/** First message of a connection: what is open now, and what the page begins with. */
export interface Hello {
  type: "hello";
  protocol: number;
  version: string;
  upload_limit_bytes: number;
  scenes: SceneEntry[];
  expected: number;
  graphs: GraphEntry[];
  start: "view" | "play";
  graph: string;
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
  graphs: GraphEntry[];
}

/** A graph was opened (again, where its id is known). */
export interface GraphReady {
  type: "graph_ready";
  graph: GraphEntry;
}

/** An input of the graph; ``default`` has one number, or three for a vector. */
export interface PlayParameter {
  name: string;
  kind: "float" | "int" | "bool" | "trigger" | "vector";
  default: number[];
  minimum: number | null;
  maximum: number | null;
  half_life_s: number;
}

/** A number of a node: the parameter that gives it, or (``parameter`` is empty) its value. */
export interface PlayNumber {
  field: string;
  parameter: string;
  value: number;
}

/** A transition of a state machine, its conditions in words. */
export interface PlayTransition {
  source: string;
  target: string;
  kind: "crossfade" | "frozen" | "inertial" | "dead";
  duration_s: number;
  when: string;
}

/** A node of the graph's tree, parents before children. */
export interface PlayNode {
  name: string;
  kind: string;
  parent: number;
  slot: string;
  at: number[];
  clip: string;
  target: string;
  sync: string;
  mask: string;
  numbers: PlayNumber[];
  states: string[];
  transitions: PlayTransition[];
  triangles: number[][];
}

/** An event of a clip. */
export interface PlayEventMark {
  name: string;
  time_s: number;
}

/** A clip of the graph. */
export interface PlayClip {
  name: string;
  duration_s: number;
  events: PlayEventMark[];
}

/** A point that touches the ground. */
export interface PlayContact {
  name: string;
  joint: number;
}

/** A graph plays: everything about it that stays as it is; frames name parts of it by their numbers. */
export interface PlayReady {
  type: "play_ready";
  player: number;
  graph: GraphEntry;
  scene: SceneEntry;
  parameters: PlayParameter[];
  nodes: PlayNode[];
  clips: PlayClip[];
  contacts: PlayContact[];
  contributors: string[];
  rate_hz: number;
}

/** An event that was fired in a step. */
export interface PlayEvent {
  name: string;
  data: string;
  clip: string;
  node: string;
  weight: number;
}

/** A transition that began in a step. */
export interface PlayChange {
  machine: string;
  source: string;
  target: string;
  kind: string;
  duration_s: number;
  interrupted: boolean;
}

/** One step of a playing graph. */
export interface PlayFrame {
  type: "play_frame";
  player: number;
  number: number;
  time_s: number;
  dt_s: number;
  heard: number;
  root: number[];
  pose: ArrayRef;
  morphs: ArrayRef;
  contacts: ArrayRef;
  parameters: ArrayRef;
  shares: ArrayRef;
  phases: ArrayRef;
  machines: ArrayRef;
  syncs: ArrayRef;
  joint: number;
  contributions: ArrayRef;
  events: PlayEvent[];
  changes: PlayChange[];
  control_us: number;
  pose_us: number;
  round_trip_ms: number;
  recorded_s: number | null;
}

/** A recording was baked; ``GET api/takes/{id}/{format}`` (glb, bvh) gives the file. */
export interface PlayTake {
  type: "play_take";
  player: number;
  id: string;
  name: string;
  frames: number;
  rate_hz: number;
  duration_s: number;
}

/** Play this graph from its first state, instead of what this page played before. */
export interface PlayOpen {
  type: "play_open";
  graph: string;
}

/** Play nothing. */
export interface PlayClose {
  type: "play_close";
}

/** Set parameters: one number each, three for a vector. */
export interface PlayInput {
  type: "play_input";
  sequence: number;
  values: Record<string, number[]>;
}

/** Frames up to this number were drawn; without it no further steps are made. */
export interface PlayAcknowledge {
  type: "play_acknowledge";
  number: number;
}

/** How time runs: not at all, slowed down, or as it is. */
export interface PlayPace {
  type: "play_pace";
  paused: boolean;
  speed: number;
}

/** Pause, and make one step of 1/60 s. */
export interface PlayStep {
  type: "play_step";
}

/** Back to the graph's first state at the origin. */
export interface PlayReset {
  type: "play_reset";
}

/** Say in every frame which clip gives how much of this joint; -1 for none. */
export interface PlayExplain {
  type: "play_explain";
  joint: number;
}

/** Begin to record, or stop and bake what was recorded. */
export interface PlayRecord {
  type: "play_record";
  on: boolean;
}

/** A surface of the crowd's characters; its colour is each character's own. */
export interface CrowdMaterial {
  name: string;
  roughness: number;
  metallic: number;
  emissive: number[];
}

/** One level of detail: one mesh with all parts. */
export interface CrowdLevel {
  positions: ArrayRef;
  normals: ArrayRef;
  triangles: ArrayRef;
  joints: ArrayRef;
  weights: ArrayRef;
  materials: ArrayRef;
  shades: ArrayRef;
  morphs: MorphData | null;
  palette: number;
  joint_count: number;
  above: number;
  every: number;
  error_mm: number;
  motion_error_mm: number;
}

/** A crowd stands: everything about it that stays. ``colors``: (N, M, 3) uint8, sRGB, of each character's materials. */
export interface CrowdReady {
  type: "crowd_ready";
  crowd: number;
  graph: string;
  count: number;
  radius_m: number;
  height_m: number;
  unit_m: number;
  behaviours: string[];
  behaviour: string;
  materials: CrowdMaterial[];
  colors: ArrayRef;
  morphs: number;
  levels: CrowdLevel[];
}

/** Characters of one level whose joints are new: ``who`` (K,) uint16, ``matrices`` (K, P, 12) uint16, to be read as int16. */
export interface CrowdUpdate {
  who: ArrayRef;
  matrices: ArrayRef;
  morphs: ArrayRef;
}

/** One step of a crowd. */
export interface CrowdFrame {
  type: "crowd_frame";
  crowd: number;
  number: number;
  time_s: number;
  dt_s: number;
  roots: ArrayRef;
  levels: ArrayRef;
  updates: CrowdUpdate[];
  steer_us: number;
  animate_us: number;
  pack_us: number;
}

/** The crowd cannot be shown, or has stopped. */
export interface CrowdFailure {
  type: "crowd_failure";
  message: string;
}

export type CrowdMessage = CrowdReady | CrowdFrame | CrowdFailure;

/** Show a crowd that plays this graph, instead of what this page showed before. */
export interface CrowdOpen {
  type: "crowd_open";
  graph: string;
  count: number;
  behaviour: string;
  seed: number;
}

/** Do something else. */
export interface CrowdBehave {
  type: "crowd_behave";
  behaviour: string;
}

/** How time runs, and how many steps are made in a second. */
export interface CrowdPace {
  type: "crowd_pace";
  paused: boolean;
  speed: number;
  rate_hz: number;
}

/** Where the camera is: the levels of detail depend on it. */
export interface CrowdView {
  type: "crowd_view";
  eye: number[];
  fov_deg: number;
}

/** Frames up to this number were drawn; without it no further steps are made. */
export interface CrowdAcknowledge {
  type: "crowd_acknowledge";
  number: number;
}

export type CrowdRequest = CrowdOpen | CrowdBehave | CrowdPace | CrowdView | CrowdAcknowledge;

export type ServerMessage = Hello | SceneReady | SceneClosed | Progress | Failure | Notice | GraphReady | PlayReady | PlayFrame | PlayTake;

/** A server message and its number; the browser acknowledges the number. */
export interface Envelope {
  sequence: number;
  message: Hello | SceneReady | SceneClosed | Progress | Failure | Notice | GraphReady | PlayReady | PlayFrame | PlayTake;
}

export type ClientMessage = Acknowledge | CloseScene | OpenSample | PlayOpen | PlayClose | PlayInput | PlayAcknowledge | PlayPace | PlayStep | PlayReset | PlayExplain | PlayRecord;
