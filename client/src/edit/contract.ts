// What the parts of the editor tell each other. Values are never changed in place: an edit makes new ones, so that what
// did not change is still the same object, and comparing is a matter of ===.

import type { RigData } from "../generated/messages";
import type { Actor } from "../view/actor";

/** As keypose.model.Interpolation. */
export enum Mode {
  Step = 0,
  Linear = 1,
  Hermite = 2,
  Bezier = 3,
  Squad = 4,
  SphericalBezier = 5,
  LogCubic = 6,
}

/** As keypose.model.Tangent. */
export enum Tangent {
  Free = 0,
  Aligned = 1,
  Vector = 2,
  Auto = 3,
  Clamped = 4,
  Flat = 5,
}

export type Kind = "scalar" | "vector" | "rotation" | "euler" | "color" | "boolean";
export type Property = "translation" | "rotation" | "euler" | "scale" | "weight" | "value";

/** As keypose.model.Channel; `key` is its unique text "target\u0000property\u0000component". */
export interface ChannelId {
  readonly key: string;
  readonly target: string;
  readonly property: Property;
  readonly component: number | null;
}

/** As keypose.model.Curve, all numbers in double precision. K keys of C components. */
export interface EditCurve {
  readonly channel: ChannelId;
  readonly kind: Kind;
  readonly components: number;
  readonly times: Float64Array; // (K,)
  readonly values: Float64Array; // (K * C)
  readonly modes: Uint8Array; // (K,) Mode of the span that starts at each key
  readonly inTangents: Float64Array | null; // (K * C) per second, where a mode is Hermite
  readonly outTangents: Float64Array | null;
  readonly inHandles: Float64Array | null; // (K * C * 2) seconds and value from the key, where a mode is Bezier
  readonly outHandles: Float64Array | null;
  readonly types: Uint8Array | null; // (K * 2) Tangent of the side before and after each key
  readonly before: string;
  readonly after: string;
}

export interface EditClip {
  readonly name: string;
  readonly rate: number | null;
  readonly curves: ReadonlyMap<string, EditCurve>; // by ChannelId.key
  readonly eulerOrders: Readonly<Record<string, string>>;
}

export interface EditPlacement {
  readonly animation: string;
  readonly start: number;
  readonly inTime: number | null;
  readonly outTime: number | null;
  readonly speed: number;
  readonly cycles: number;
  readonly fadeIn: number;
  readonly fadeOut: number;
  readonly timeWarp: EditCurve | null;
  readonly weight: EditCurve | null;
  readonly hold: boolean;
  readonly muted: boolean;
}

export interface EditLayer {
  readonly name: string;
  readonly placements: readonly EditPlacement[];
  readonly mode: "replace" | "add";
  readonly influence: number | EditCurve;
  readonly joints: Readonly<Record<string, number>>; // empty: all
  readonly properties: readonly Property[] | null;
  readonly muted: boolean;
  readonly solo: boolean;
  readonly locked: boolean;
}

export interface EditMarker {
  readonly time: number;
  readonly name: string;
}

export interface EditTimeline {
  readonly name: string;
  readonly layers: readonly EditLayer[]; // lowest first
  readonly rate: number;
  readonly start: number;
  readonly end: number;
  readonly holdFrames: number;
  readonly markers: readonly EditMarker[];
}

/** A pose of the library: local transforms by joint, and morph weights by name. */
export interface StoredPose {
  readonly name: string;
  readonly joints: Readonly<Record<string, { translation: number[]; rotation: number[]; scale: number[] }>>;
  readonly morphs: Readonly<Record<string, number>>;
}

/** The document as the page knows it; `character` of a timeline is the actor that it moves. */
export interface EditDocument {
  readonly name: string;
  readonly clips: ReadonlyMap<string, EditClip>;
  readonly timelines: ReadonlyMap<string, EditTimeline>;
  readonly poses: ReadonlyMap<string, StoredPose>;
  /** The rigs of its characters: controls that move their joints. */
  readonly rigs: readonly RigData[];
  /** Character name -> id of the scene that holds its mesh, and the timeline that it performs. */
  readonly characters: readonly { readonly name: string; readonly scene: string; readonly timeline: string }[];
}

/** Part of a document that a step replaces; null removes. */
export interface Changes {
  /** clip name -> curves by channel key. A curve of null is removed; a clip that does not exist yet is made. */
  readonly curves?: ReadonlyMap<string, ReadonlyMap<string, EditCurve | null>>;
  readonly clips?: ReadonlyMap<string, EditClip | null>;
  readonly timelines?: ReadonlyMap<string, EditTimeline | null>;
  readonly poses?: ReadonlyMap<string, StoredPose | null>;
}

/** Selected keys: channel key -> sorted indices of keys. */
export type KeySelection = ReadonlyMap<string, Uint32Array>;

/** What every part of the editor may ask of it. Implemented by `edit/editor.svelte.ts`; fields are reactive. */
export interface Editor {
  readonly document: EditDocument;
  /** What is shown now: the document, or a preview of what is being dragged. */
  readonly shown: EditDocument;
  /** The character, timeline, layer and clip that keys go to. */
  readonly actor: Actor | null;
  readonly timeline: EditTimeline | null;
  readonly layer: EditLayer | null;
  readonly clip: EditClip | null;
  /** Channels that the dope sheet and the graph editor list, in order, after search and filters. */
  readonly channels: readonly EditCurve[];
  /** Selected joints of the actor, the active one last. */
  selectedJoints: readonly number[];
  selection: KeySelection;
  /** Channels hidden in the graph editor, muted, locked or solo (channel keys). */
  hidden: ReadonlySet<string>;
  muted: ReadonlySet<string>;
  locked: ReadonlySet<string>;
  autoKey: boolean;
  snap: boolean;
  /** Selected time, in seconds of the timeline: operators work there alone. */
  span: readonly [number, number] | null;
  /** Seconds on the timeline. */
  time: number;
  seek(time: number): void;
  /** Show changes without making them (while something is dragged); null shows the document again. */
  preview(changes: Changes | null): void;
  /** Make changes: one step of undo. Shown at once, sent to the server, which has the last word. */
  commit(label: string, changes: Changes): void;
  /** Run an operator of the server on the clip (simplify, smooth, ease ...); one step of undo. */
  operate(name: string, parameters: Record<string, unknown>): Promise<void>;
  undo(): void;
  redo(): void;
  /** Local values set by hand and not keyed yet, by channel key: shown over the animation until time moves or they are keyed. May be set, to take such a pose back. */
  posed: ReadonlyMap<string, readonly number[]>;
  /**
   * Set local values of joints (whole translation, rotation wxyz or scale) by hand. With auto-key they are keyed at the
   * current time when `done`; without, they stay until time moves. While dragging, `done` is false.
   */
  pose(values: ReadonlyMap<string, readonly number[]>, label: string, done: boolean): void;
  /** Back from what is posed and not keyed to the animation; undo brings it back. */
  dropPosed(): void;
  /** Key what the joints show now, at the current time, on the active clip, and `more` channels of weights and numbers. */
  insertKeys(joints: readonly number[], properties: readonly Property[], more?: readonly ChannelId[]): void;
  /** Say something to the user. */
  toast(kind: "error" | "info", title: string, message: string): void;
}

/** The channel of a joint's or morph's property; the text of `ChannelId.key`. */
export function channelOf(target: string, property: Property, component: number | null = null): ChannelId {
  return { key: `${target}\u0000${property}\u0000${component ?? ""}`, target, property, component };
}
