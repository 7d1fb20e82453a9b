// Generated from src/keypose/studio/messages.py by `python -m keypose.studio.typescript`. Do not edit.

export const PROTOCOL = 3;

/** An array in the body of the container: bytes ``offset`` to ``offset + bytes``, row-major. */
export interface ArrayRef {
  offset: number;
  bytes: number;
  element: "float32" | "float64" | "uint8" | "uint16" | "uint32" | "int32";
  shape: number[];
}

/** A scene that can be fetched, and how many bytes it is. */
export interface SceneEntry {
  id: string;
  name: string;
  bytes: number;
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
  controls: number;
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
  attributes: Record<string, number>;
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

/** Sparse animation: curves; ``euler_orders`` by joint, XYZ for those not named. */
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

/** A control: its place in the hierarchy (-1 for none above it), rest transform and looks, as `keypose.model.Control`. */
export interface RigControl {
  name: string;
  parent: number;
  translation: number[];
  rotation: number[];
  scale: number[];
  shape: "circle" | "square" | "box" | "ball" | "diamond" | "arrows" | "pin" | "foot";
  size_m: number;
  offset_m: number[];
  side: "middle" | "left" | "right";
  spaces: string[];
  space_attribute: string;
  moves: ("translation" | "rotation" | "scale")[];
}

/** A number of a rig, shown beside a control; keyed as a value channel of its name. */
export interface RigAttribute {
  name: string;
  control: string;
  default: number;
  minimum: number;
  maximum: number;
  choices: string[];
  angle: boolean;
}

/** What moves some joints; ``switch`` is the attribute that goes from FK (0) to IK (1), empty where it has none. */
export interface RigModule {
  name: string;
  kind: string;
  joints: string[];
  fk: string[];
  ik: string[];
  switch: string;
}

/** A character's rig; ``revision`` is another for every change of it. */
export interface RigData {
  name: string;
  character: string;
  revision: number;
  controls: RigControl[];
  attributes: RigAttribute[];
  modules: RigModule[];
}

/** Rig a humanoid; where its timeline moves it already, that motion goes to keys on the controls. */
export interface RigAdd {
  type: "rig_add";
  character: string;
  fit: boolean;
}

/** Put what a character's timeline makes of its joints on its controls, as a clip of its own in that timeline. */
export interface RigFit {
  type: "rig_fit";
  rig: string;
}

/** Put what the controls make of the joints into a clip of joints, which takes their place in the timeline. */
export interface RigBake {
  type: "rig_bake";
  rig: string;
}

/** Take a rig off its character; ``bake`` keeps the motion, as keys on joints. */
export interface RigRemove {
  type: "rig_remove";
  rig: string;
  bake: boolean;
}

export type RigAsked = RigAdd | RigFit | RigBake | RigRemove;

/** Header: what some of a rig's controls and numbers give, (B) poses at once. */
export interface RigPoseRequest {
  type: "rig_pose";
  rig: string;
  controls: ArrayRef;
  joints: ArrayRef;
  values: ArrayRef;
  wish: "none" | "match_ik_to_fk" | "match_fk_to_ik" | "switch_space" | "mirror";
  modules: string[];
  control: string;
  space: number;
}

/** Header of the answer, and of a track. */
export interface RigPosed {
  type: "rig_posed";
  rig: string;
  revision: number;
  keyed: boolean;
  start_s: number;
  rate_hz: number;
  joints: ArrayRef;
  model_from_control: ArrayRef;
  model_from_frame: ArrayRef;
  controls: ArrayRef | null;
  values: ArrayRef | null;
}

/** What a curve drives, without the curve. */
export interface ChannelData {
  target: string;
  property: "translation" | "rotation" | "euler" | "scale" | "weight" | "value";
  component: number | null;
}

/** A clip of the project with all its curves. */
export interface ProjectClip {
  name: string;
  rate_hz: number | null;
  curves: CurveData[];
  euler_orders: Record<string, string>;
}

/** As `keypose.model.Placement`; curves of time and weight drive no channel. */
export interface PlacementData {
  animation: string;
  start_s: number;
  in_s: number | null;
  out_s: number | null;
  speed: number;
  cycles: number;
  fade_in_s: number;
  fade_out_s: number;
  time_warp: CurveData | null;
  weight: CurveData | null;
  hold: boolean;
  muted: boolean;
}

/** As `keypose.model.Layer`; ``joints`` is empty and ``properties`` null for all. */
export interface LayerData {
  name: string;
  placements: PlacementData[];
  mode: "replace" | "add";
  influence: number | CurveData;
  joints: Record<string, number>;
  properties: ("translation" | "rotation" | "euler" | "scale" | "weight" | "value")[] | null;
  muted: boolean;
  solo: boolean;
  locked: boolean;
}

/** A named moment on a timeline. */
export interface TimeMarker {
  time_s: number;
  name: string;
}

/** As `keypose.model.Timeline`; layers lowest first. */
export interface TimelineData {
  name: string;
  layers: LayerData[];
  rate_hz: number;
  start_s: number;
  end_s: number;
  hold_frames: number;
  markers: TimeMarker[];
}

/** A joint's local transform; rotation wxyz. */
export interface JointTransform {
  translation: number[];
  rotation: number[];
  scale: number[];
}

/** A pose of the library, by names of joints and morphs. */
export interface PoseData {
  name: string;
  joints: Record<string, JointTransform>;
  morphs: Record<string, number>;
}

/** A character; ``GET api/scenes/{scene.id}`` holds its mesh. ``timeline`` moves it, empty for none. */
export interface ProjectCharacter {
  name: string;
  scene: SceneEntry;
  timeline: string;
}

/** What an operator asks for; ``unit`` is for people. A joint is its name, empty for the operator's own choice. */
export interface OperatorParameter {
  name: string;
  label: string;
  kind: "number" | "integer" | "boolean" | "choice" | "joint" | "text";
  default: number | boolean | string;
  low: number | null;
  high: number | null;
  unit: string;
  choices: string[];
  help: string;
}

/** An operator as its form is drawn; ``GET api/project/operators`` lists all. ``group``: what has to be selected for it. */
export interface OperatorSpec {
  name: string;
  label: string;
  group: string;
  help: string;
  parameters: OperatorParameter[];
}

/** Where the project stands; in every message about it. */
export interface ProjectStatus {
  name: string;
  path: string;
  revision: number;
  saved_revision: number;
  undo: string;
  redo: string;
  unsafe: string;
}

/** A project that was not saved before its studio ended; ``changed_s`` is seconds since 1970. */
export interface Recoverable {
  id: string;
  name: string;
  path: string;
  edits: number;
  changed_s: number;
}

/** The whole project; sent to a page that watches, and whenever another project takes its place. */
export interface ProjectState {
  type: "project_state";
  status: ProjectStatus;
  characters: ProjectCharacter[];
  clips: ProjectClip[];
  timelines: TimelineData[];
  poses: PoseData[];
  rigs: RigData[];
  settings: Record<string, string | number | boolean>;
  recoverable: Recoverable[];
  operators: string[];
  exports: string[];
  folder: string;
}

/** What changed in a clip: its curves now, and channels that have none any more; the clip is made where it was not. */
export interface ClipChange {
  name: string;
  rate_hz: number | null;
  euler_orders: Record<string, string>;
  curves: CurveData[];
  removed: ChannelData[];
}

/** The difference of two documents, and where the project stands now. */
export interface ProjectChanged {
  type: "project_changed";
  status: ProjectStatus;
  edit: string;
  label: string;
  cause: "edit" | "undo" | "redo" | "save";
  clips: ClipChange[];
  removed_clips: string[];
  timelines: TimelineData[];
  removed_timelines: string[];
  poses: PoseData[];
  removed_poses: string[];
  rigs: RigData[] | null;
  characters: ProjectCharacter[] | null;
  settings: Record<string, string | number | boolean> | null;
}

/** A project was not saved, for a reason that a person can decide about; say it again with ``force`` to do it. */
export interface ProjectNotSaved {
  type: "project_not_saved";
  path: string;
  reason: "exists" | "changed" | "locked" | "failed";
  message: string;
}

/** A project in a folder. */
export interface FolderFile {
  name: string;
  bytes: number;
  changed_s: number;
}

/** What a dialog to open or save shows: the folders and projects of a folder. */
export interface ProjectFolder {
  type: "project_folder";
  folder: string;
  parent: string;
  folders: string[];
  files: FolderFile[];
}

export type ProjectMessage = ProjectState | ProjectChanged | ProjectNotSaved | ProjectFolder;

/** Send the project, and from now on what changes in it. */
export interface ProjectWatch {
  type: "project_watch";
}

/** Begin a project, with a character where ``character`` is ``sample:NAME`` or the id of a scene. */
export interface ProjectNew {
  type: "project_new";
  name: string;
  character: string;
  discard: boolean;
}

/** Open a project file instead. */
export interface ProjectOpen {
  type: "project_open";
  path: string;
  discard: boolean;
}

/** Save under a path, or where it was saved before (``path`` is null); ``force`` overwrites what is there. */
export interface ProjectSave {
  type: "project_save";
  path: string | null;
  force: boolean;
}

/** One step back. */
export interface ProjectUndo {
  type: "project_undo";
}

/** One step forward again. */
export interface ProjectRedo {
  type: "project_redo";
}

/** Go on with a project that was not saved before its studio ended. */
export interface ProjectRecover {
  type: "project_recover";
  id: string;
}

/** Nobody wants what could be recovered. */
export interface ProjectDiscard {
  type: "project_discard";
  id: string;
}

/** Add a built-in character (``sample:human``) or those of an opened scene (its id), each with a timeline and a clip. */
export interface ProjectAddCharacter {
  type: "project_add_character";
  source: string;
}

/** Remove a character; its timeline and clips stay. */
export interface ProjectRemoveCharacter {
  type: "project_remove_character";
  name: string;
}

/** Copy an animation of an opened scene (its id, or ``sample:NAME``) into the project, as keys; -1 for all of them. */
export interface ProjectImportClip {
  type: "project_import_clip";
  source: string;
  animation: number;
}

/** List the projects of a folder; empty for where the studio was started. */
export interface ProjectBrowse {
  type: "project_browse";
  folder: string;
}

export type ProjectRequest = ProjectWatch | ProjectNew | ProjectOpen | ProjectSave | ProjectUndo | ProjectRedo | ProjectRecover | ProjectDiscard | ProjectAddCharacter | ProjectRemoveCharacter | ProjectImportClip | ProjectBrowse;

/** Curves of a clip that take the place of those of their channels, and channels that lose theirs. */
export interface SetCurves {
  kind: "set_curves";
  clip: string;
  curves: CurveData[];
  removed: ChannelData[];
  euler_orders: Record<string, string>;
}

/** A whole clip, in place of the one of its name. */
export interface SetClip {
  kind: "set_clip";
  clip: ProjectClip;
}

/** Remove a clip and its placements. */
export interface RemoveClip {
  kind: "remove_clip";
  name: string;
}

/** A whole timeline, in place of the one of its name; the clips that it places exist, or are made by the same edit. */
export interface SetTimeline {
  kind: "set_timeline";
  timeline: TimelineData;
}

/** Remove a timeline; characters that it moves are moved by none. */
export interface RemoveTimeline {
  kind: "remove_timeline";
  name: string;
}

/** A pose of the library, in place of the one of its name. */
export interface SetPose {
  kind: "set_pose";
  pose: PoseData;
}

/** Remove a pose of the library. */
export interface RemovePose {
  kind: "remove_pose";
  name: string;
}

/** Which timeline moves a character; empty for none. */
export interface SetPerformance {
  kind: "set_performance";
  character: string;
  timeline: string;
}

/** Give something another name; whatever names it follows. */
export interface Rename {
  kind: "rename";
  what: "project" | "character" | "clip" | "timeline" | "pose";
  name: string;
  to: string;
}

/** Settings that an editor keeps with the project; null removes one. */
export interface SetSettings {
  kind: "set_settings";
  settings: Record<string, string | number | boolean | null>;
}

export type EditCommand = SetCurves | SetClip | RemoveClip | SetTimeline | RemoveTimeline | SetPose | RemovePose | SetPerformance | Rename | SetSettings;

/** Header of ``POST api/project/edit``: commands that are one step of undo, all or none. */
export interface EditRequest {
  type: "edit";
  id: string;
  label: string;
  merge: string;
  commands: (SetCurves | SetClip | RemoveClip | SetTimeline | RemoveTimeline | SetPose | RemovePose | SetPerformance | Rename | SetSettings)[];
}

/** Keys of a channel: indices (N,) uint32, rising; null for all. */
export interface KeyChoice {
  channel: ChannelData;
  keys: ArrayRef | null;
}

/** Header of ``POST api/project/operate``: run an operator on channels of a clip; one step of undo. */
export interface OperateRequest {
  type: "operate";
  id: string;
  operator: string;
  clip: string;
  character: string;
  channels: KeyChoice[];
  start_s: number | null;
  end_s: number | null;
  parameters: Record<string, string | number | boolean | number[]>;
}

/** Answer to an edit or operator, once it cannot be lost any more; ``error`` is empty where it was done. */
export interface EditResult {
  id: string;
  revision: number;
  error: string;
  report: string;
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
  start: "view" | "play" | "edit";
  graph: string;
  recoverable: number;
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

export type ServerMessage = Hello | SceneReady | SceneClosed | Progress | Failure | Notice | GraphReady | PlayReady | PlayFrame | PlayTake | ProjectState | ProjectChanged | ProjectNotSaved | ProjectFolder;

/** A server message and its number; the browser acknowledges the number. */
export interface Envelope {
  sequence: number;
  message: Hello | SceneReady | SceneClosed | Progress | Failure | Notice | GraphReady | PlayReady | PlayFrame | PlayTake | ProjectState | ProjectChanged | ProjectNotSaved | ProjectFolder;
}

export type ClientMessage = Acknowledge | CloseScene | OpenSample | PlayOpen | PlayClose | PlayInput | PlayAcknowledge | PlayPace | PlayStep | PlayReset | PlayExplain | PlayRecord | ProjectWatch | ProjectNew | ProjectOpen | ProjectSave | ProjectUndo | ProjectRedo | ProjectRecover | ProjectDiscard | ProjectAddCharacter | ProjectRemoveCharacter | ProjectImportClip | ProjectBrowse;

/** Show a scene on this page: one that is open, or a built-in one as ``sample:NAME``. */
export interface RetargetSubjectRequest {
  type: "retarget_subject";
  scene: string;
}

/** Find the roles of a character anew; ``known`` ones are kept as they are. */
export interface RetargetRolesRequest {
  type: "retarget_roles";
  scene: string;
  character: number;
  known: Record<string, string>;
}

/** Put a scene's animation on another scene's character. */
export interface RetargetRequest {
  type: "retarget";
  source: string;
  source_character: number;
  animation: number;
  target: string;
  target_character: number;
  source_roles: Record<string, string> | null;
  target_roles: Record<string, string> | null;
  source_reference: string;
  target_reference: string;
  scale: number | null;
  plant: boolean;
  keep_hands: boolean;
  props: number[][];
  rate_hz: number | null;
  against: string;
}

export type RetargetAsked = RetargetSubjectRequest | RetargetRolesRequest | RetargetRequest;

/** Which joint plays which role, and how sure that is (0..1); ``missing`` are needed and played by none. */
export interface RetargetRoles {
  roles: Record<string, string>;
  confidence: Record<string, number>;
  missing: string[];
  all_fours: boolean;
  notes: string[];
}

/** A scene that the page may show, and the roles of each of its characters. */
export interface RetargetSubject {
  scene: SceneEntry | null;
  characters: RetargetRoles[];
  error: string;
}

/** The steps of one foot (``left_foot`` ... or, of who goes on four, ``left_hand`` ...): when it is on the ground. */
export interface RetargetFoot {
  role: string;
  source: string[];
  target: string[];
  steps: number[];
  source_slides_cm_s: number[];
  target_slides_cm_s: number[];
}

/** A retargeted motion beside somebody else's result; ``error`` says why they cannot be compared. */
export interface RetargetBeside {
  name: string;
  error: string;
  direction_deg: Record<string, number>;
  mean_direction_deg: number;
  turned_deg: number;
  shift_s: number;
  slide_cm_s: number;
  frames: number;
}

/** The motion on the target and its figures; ``error`` says why there is none. */
export interface RetargetDone {
  id: string;
  scene: SceneEntry | null;
  error: string;
  name: string;
  frames: number;
  rate_hz: number;
  took_s: number;
  scale: number;
  direction_deg: Record<string, number>;
  mean_direction_deg: number;
  source_slide_cm_s: number;
  loose_slide_cm_s: number;
  slide_cm_s: number;
  worst_slide_cm_s: number;
  sink_cm: number;
  contact_frames: number;
  hands_off_cm: number | null;
  props: number[][];
  beside: RetargetBeside | null;
  feet: RetargetFoot[];
  exports: string[];
  notes: string[];
}
