// Documents are values: an edit makes a new one that shares everything that did not change.

import { clipRange } from "../anim/timeline";
import type {
  Changes,
  EditClip,
  EditCurve,
  EditDocument,
  EditLayer,
  EditPlacement,
  EditTimeline,
} from "./contract";

export const EMPTY: EditDocument = {
  name: "",
  clips: new Map(),
  timelines: new Map(),
  poses: new Map(),
  rigs: [],
  characters: [],
};

/** Film's rate, as in the lecture notes. */
const RATE = 25;

export function newClip(name: string, rate: number | null = RATE): EditClip {
  return { name, rate, curves: new Map(), eulerOrders: {} };
}

export function newPlacement(animation: string): EditPlacement {
  return {
    animation,
    start: 0,
    inTime: null,
    outTime: null,
    speed: 1,
    cycles: 1,
    fadeIn: 0,
    fadeOut: 0,
    timeWarp: null,
    weight: null,
    hold: true,
    muted: false,
  };
}

/** A placement in which the clip's time is the timeline's: what keys are set on. */
export function basePlacement(animation: string): EditPlacement {
  return { ...newPlacement(animation), inTime: 0 };
}

export function newLayer(name: string, placements: readonly EditPlacement[] = [], mode: EditLayer["mode"] = "replace"): EditLayer {
  return { name, placements, mode, influence: 1, joints: {}, properties: null, muted: false, solo: false, locked: false };
}

/** A name that no other has: "wave", "wave 2", "wave 3". */
export function freeName(wanted: string, taken: Iterable<string>): string {
  const used = new Set(taken);
  if (!used.has(wanted)) return wanted;
  const stem = wanted.replace(/ \d+$/, "");
  for (let n = 2; ; n++) if (!used.has(`${stem} ${n}`)) return `${stem} ${n}`;
}

function merged<V>(from: ReadonlyMap<string, V>, changes: ReadonlyMap<string, V | null> | undefined): ReadonlyMap<string, V> {
  if (!changes || changes.size === 0) return from;
  const out = new Map(from);
  let changed = false;
  for (const [key, value] of changes) {
    if (value === null) changed = out.delete(key) || changed;
    else if (out.get(key) !== value) {
      out.set(key, value);
      changed = true;
    }
  }
  return changed ? out : from;
}

/** The document after changes; the same object where nothing changed. */
export function apply(document: EditDocument, changes: Changes): EditDocument {
  let clips = merged(document.clips, changes.clips);
  if (changes.curves && changes.curves.size > 0) {
    const next = new Map<string, EditClip>();
    for (const [name, curves] of changes.curves) {
      const clip = clips.get(name) ?? newClip(name);
      const own = merged(clip.curves, curves);
      if (own !== clip.curves || !clips.has(name)) next.set(name, { ...clip, curves: own });
    }
    clips = merged(clips, next);
  }
  const timelines = merged(document.timelines, changes.timelines);
  const poses = merged(document.poses, changes.poses);
  if (clips === document.clips && timelines === document.timelines && poses === document.poses) return document;
  return { ...document, clips, timelines, poses };
}

const sameBytes = (a: ArrayBufferView | null, b: ArrayBufferView | null): boolean => {
  if (a === b) return true;
  if (!a || !b || a.byteLength !== b.byteLength) return false;
  // key arrays are multiples of 8 bytes but for modes and types, which are compared byte by byte
  if (a instanceof Float64Array && b instanceof Float64Array) {
    for (let i = 0; i < a.length; i++) if (!Object.is(a[i], b[i])) return false;
    return true;
  }
  const x = new Uint8Array(a.buffer, a.byteOffset, a.byteLength), y = new Uint8Array(b.buffer, b.byteOffset, b.byteLength);
  for (let i = 0; i < x.length; i++) if (x[i] !== y[i]) return false;
  return true;
};

const ARRAYS = ["times", "values", "modes", "inTangents", "outTangents", "inHandles", "outHandles", "types"] as const;

function sameCurve(a: EditCurve, b: EditCurve): boolean {
  return (
    a === b ||
    (a.channel.key === b.channel.key &&
      a.kind === b.kind &&
      a.before === b.before &&
      a.after === b.after &&
      ARRAYS.every((name) => sameBytes(a[name], b[name])))
  );
}

/**
 * `next`, made of the objects of `previous` wherever they hold the same: what the server sends back of our own edit is
 * then what is shown already, and nothing is drawn again.
 */
export function reuse(previous: EditDocument, next: EditDocument): EditDocument {
  const clips = new Map<string, EditClip>();
  let sameClips = previous.clips.size === next.clips.size;
  for (const [name, clip] of next.clips) {
    const old = previous.clips.get(name);
    const kept = old && old !== clip ? reuseClip(old, clip) : clip;
    clips.set(name, kept);
    sameClips &&= kept === old;
  }
  const timelines = reuseValues(previous.timelines, next.timelines);
  const poses = reuseValues(previous.poses, next.poses);
  return { ...next, clips: sameClips ? previous.clips : clips, timelines, poses };
}

function reuseClip(old: EditClip, clip: EditClip): EditClip {
  const curves = new Map<string, EditCurve>();
  let same = old.curves.size === clip.curves.size && old.rate === clip.rate && sameJson(old.eulerOrders, clip.eulerOrders);
  for (const [key, curve] of clip.curves) {
    const known = old.curves.get(key);
    const kept = known && sameCurve(known, curve) ? known : curve;
    curves.set(key, kept);
    same &&= kept === known;
  }
  return same ? old : { ...clip, curves };
}

// a timeline is small; its curves hold typed arrays, which JSON writes as objects of numbers
const sameJson = (a: unknown, b: unknown) => a === b || JSON.stringify(a) === JSON.stringify(b);

function reuseValues<V>(previous: ReadonlyMap<string, V>, next: ReadonlyMap<string, V>): ReadonlyMap<string, V> {
  if (previous === next) return previous;
  let same = previous.size === next.size;
  const out = new Map<string, V>();
  for (const [name, value] of next) {
    const old = previous.get(name);
    const kept = old !== undefined && sameJson(old, value) ? old : value;
    out.set(name, kept);
    same &&= kept === old;
  }
  return same ? previous : out;
}

// ---- timelines -------------------------------------------------------------------------------------------------------

/** A timeline with one layer replaced, or removed where `layer` is null. */
export function withLayer(timeline: EditTimeline, name: string, layer: EditLayer | null): EditTimeline {
  return { ...timeline, layers: timeline.layers.flatMap((l) => (l.name !== name ? [l] : layer ? [layer] : [])) };
}

/** Seconds of the timeline -> seconds of the clip that is placed, without its cycles. */
export function clipTime(placement: EditPlacement, clip: EditClip | undefined, time: number): number {
  const [first, last] = clip ? clipRange(clip) : [0, 0];
  const start = placement.inTime ?? first, end = placement.outTime ?? last;
  const elapsed = (time - placement.start) * placement.speed;
  return placement.speed < 0 ? end + elapsed : start + elapsed;
}

/** The times of all keys of a clip, sorted, each once. */
export function keyTimes(curves: Iterable<EditCurve>): Float64Array {
  const all = new Set<number>();
  for (const { times } of curves) for (const time of times) all.add(time);
  return Float64Array.from(all).sort();
}
