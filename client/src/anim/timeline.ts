// Timelines over a rig: placements in their own time, composed to layers, and layers over each other, as
// keypose.evaluate.sample_timeline does. What a document's edit left alone is not bound again.

import type { EditClip, EditCurve, EditDocument, EditLayer, EditPlacement, EditTimeline } from "../edit/contract";
import type { Binding } from "./animation";
import { Curve } from "./curve";
import { EULER_ORDER, eulerFromQuat, quatFromEuler } from "./euler";
import { matchRig } from "./matching";
import { Pose, type Rig } from "./rig";
import { conjugateMultiply, multiply, normalize, powerShort, slerp } from "./rotation";

type Source = Pick<EditDocument, "clips" | "timelines">;

/** A frame number computed from a time may miss it by rounding. */
const FRAME_SLACK = 1e-6;

/** The time that the exposure shows: the start of the held frames that a time falls into. */
export function exposedTime(timeline: EditTimeline, time: number): number {
  if (timeline.holdFrames === 0) return time;
  const step = timeline.holdFrames / timeline.rate;
  return timeline.start + Math.floor((time - timeline.start) / step + FRAME_SLACK) * step;
}

/** First and last key of a clip. */
export function clipRange(clip: EditClip): [number, number] {
  let start = Infinity, end = -Infinity;
  for (const { times } of clip.curves.values()) {
    start = Math.min(start, times[0]);
    end = Math.max(end, times[times.length - 1]);
  }
  return start <= end ? [start, end] : [0, 0];
}

function partOf(placement: EditPlacement, clip: EditClip): [number, number] {
  const [first, last] = clipRange(clip);
  const start = placement.inTime ?? first;
  return [start, Math.max(start, placement.outTime ?? last)];
}

/** Seconds of the timeline that a placement lasts. */
export function placementDuration(placement: EditPlacement, clip: EditClip): number {
  if (placement.timeWarp) return Math.max(0, placement.timeWarp.times.at(-1)!);
  const [start, end] = partOf(placement, clip);
  return (placement.cycles * (end - start)) / Math.abs(placement.speed);
}

/** The clip's own time at a time of the timeline, and how strongly the placement counts there. */
export function placementTime(placement: EditPlacement, clip: EditClip, time: number): { own: number; weight: number } {
  const duration = placementDuration(placement, clip);
  const since = time - placement.start;
  const elapsed = Math.max(0, Math.min(duration, since));
  const [start, end] = partOf(placement, clip);
  const length = end - start;
  const rate = Math.abs(placement.speed);
  let own = start;
  if (placement.timeWarp) own = start + number(placement.timeWarp, elapsed);
  else if (length > 0) {
    const gone = elapsed * rate;
    const cycle = Math.min(Math.floor(gone / length), Math.ceil(placement.cycles) - 1);
    let into = Math.max(0, Math.min(length, gone - cycle * length));
    if (placement.cycles === 1) {
      const backwards = placement.speed < 0;
      if ((backwards ? placement.outTime : placement.inTime) === null) into += Math.min(since, 0) * rate;
      if ((backwards ? placement.inTime : placement.outTime) === null) into += Math.max(since - duration, 0) * rate;
    }
    own = placement.speed > 0 ? start + into : end - into;
  }
  let weight = placement.weight ? Math.max(0, Math.min(1, number(placement.weight, elapsed))) : 1;
  if (placement.fadeIn > 0) weight *= smoothstep(since / placement.fadeIn);
  if (placement.fadeOut > 0) weight *= smoothstep((duration - since) / placement.fadeOut);
  if (!placement.hold && (since < 0 || since > duration)) weight = 0;
  return { own, weight };
}

const smoothstep = (share: number) => {
  const x = Math.max(0, Math.min(1, share));
  return x * x * (3 - 2 * x);
};

// ---- curves of a document ------------------------------------------------------------------------------------------

const evaluators = new WeakMap<EditCurve, Curve>();

/** A curve ready to be evaluated; made once for each version of it. */
export function evaluator(curve: EditCurve): Curve {
  let found = evaluators.get(curve);
  if (!found) evaluators.set(curve, (found = new Curve(curve)));
  return found;
}

const one = new Float64Array(1);

function number(curve: EditCurve, time: number): number {
  evaluator(curve).sample(time, one, 0);
  return one[0];
}

type Field = "translations" | "rotations" | "scales" | "morphs";
const FIELDS: Record<string, [Field, number]> = {
  translation: ["translations", 3],
  rotation: ["rotations", 4],
  scale: ["scales", 3],
  weight: ["morphs", 1],
};

interface Track {
  readonly field: Field;
  readonly at: number;
  readonly curve: Curve;
}

interface Angles {
  readonly joint: number;
  readonly order: string;
  readonly rest: Float64Array;
  readonly whole: Curve | null;
  readonly parts: readonly { readonly component: number; readonly curve: Curve }[];
}

/** A clip bound to a rig by the names of joints and morphs. */
class BoundClip {
  private readonly tracks: Track[] = [];
  private readonly angles: Angles[] = [];
  /** Flat indices that it drives: components of translations and scales, joints, morph channels. */
  readonly translations: Int32Array;
  readonly rotations: Int32Array;
  readonly scales: Int32Array;
  readonly morphs: Int32Array;
  private readonly three = new Float64Array(3);

  constructor(clip: EditClip, rig: Rig, morphNames: readonly string[]) {
    const driven = { translations: new Set<number>(), rotations: new Set<number>(), scales: new Set<number>(), morphs: new Set<number>() };
    const curves = [...clip.curves.values()];
    const joints = jointsOf(curves, rig);
    // components come after the whole channel, which they cover
    curves.sort((a, b) => (a.channel.component === null ? 0 : 1) - (b.channel.component === null ? 0 : 1));
    const eulers = new Map<number, { target: string; whole: Curve | null; parts: { component: number; curve: Curve }[] }>();
    for (const curve of curves) {
      const { target, property, component } = curve.channel;
      const isNumber = property === "weight" || property === "value";
      const index = property === "weight" ? morphNames.indexOf(target) : property === "value" ? rig.attributeIndex(target) : (joints.get(target) ?? -1);
      if (isNumber && curve.components !== 1) continue;
      if (index < 0) continue;
      if (property === "euler") {
        const found = eulers.get(index) ?? { target, whole: null, parts: [] };
        eulers.set(index, found);
        if (component === null) found.whole = evaluator(curve);
        else found.parts.push({ component, curve: evaluator(curve) });
        driven.rotations.add(index);
        continue;
      }
      const [field, width] = FIELDS[isNumber ? "weight" : property];
      this.tracks.push({ field, at: index * width + (component ?? 0), curve: evaluator(curve) });
      if (field === "rotations" || field === "morphs") driven[field].add(index);
      else if (component !== null) driven[field].add(3 * index + component);
      else for (let c = 0; c < 3; c++) driven[field].add(3 * index + c);
    }
    for (const [joint, { target, whole, parts }] of eulers) {
      const order = clip.eulerOrders[target] ?? EULER_ORDER;
      const rest = new Float64Array(3);
      eulerFromQuat(rig.rest.rotations, 4 * joint, order, rest, 0);
      this.angles.push({ joint, order, rest, whole, parts });
    }
    this.translations = Int32Array.from(driven.translations);
    this.rotations = Int32Array.from(driven.rotations);
    this.scales = Int32Array.from(driven.scales);
    this.morphs = Int32Array.from(driven.morphs);
  }

  /** Write what the clip drives; the rest of the pose stays as it is. */
  apply(time: number, pose: Pose): void {
    for (let n = 0; n < this.tracks.length; n++) {
      const { field, at, curve } = this.tracks[n];
      curve.sample(time, pose[field], at);
    }
    const { three } = this;
    for (const { joint, order, rest, whole, parts } of this.angles) {
      if (whole) whole.sample(time, three, 0);
      else three.set(rest);
      for (const { component, curve } of parts) curve.sample(time, three, component);
      quatFromEuler(three, 0, order, pose.rotations, 4 * joint);
    }
  }
}

/** Name in the clip -> joint of the rig. */
function jointsOf(curves: readonly EditCurve[], rig: Rig): Map<string, number> {
  const names = new Set<string>();
  for (const { channel } of curves) if (channel.property !== "weight" && channel.property !== "value") names.add(channel.target);
  let exact = true;
  for (const name of names) if (rig.index(name) < 0) exact = false;
  if (exact) return new Map([...names].map((name) => [name, rig.index(name)]));
  return new Map([...matchRig(names, rig)].map(([own, source]) => [source, rig.index(own)]));
}

const boundClips = new WeakMap<EditClip, WeakMap<Rig, BoundClip>>();

function bound(clip: EditClip, rig: Rig, morphNames: readonly string[]): BoundClip {
  let rigs = boundClips.get(clip);
  if (!rigs) boundClips.set(clip, (rigs = new WeakMap()));
  let found = rigs.get(rig);
  if (!found) rigs.set(rig, (found = new BoundClip(clip, rig, morphNames)));
  return found;
}

// ---- layers --------------------------------------------------------------------------------------------------------

interface Placed {
  readonly placement: EditPlacement;
  readonly clip: EditClip;
  readonly bound: BoundClip;
}

/** What a layer wants and how strongly; entries that no clip of it drives are meaningless. */
class Drive {
  readonly value: Pose;
  readonly translations: Float64Array;
  readonly rotations: Float64Array;
  readonly scales: Float64Array;
  readonly morphs: Float64Array;

  constructor(joints: number, morphs: number) {
    this.value = new Pose(joints, morphs);
    this.translations = new Float64Array(3 * joints);
    this.rotations = new Float64Array(joints);
    this.scales = new Float64Array(3 * joints);
    this.morphs = new Float64Array(morphs);
  }
}

class BoundLayer {
  private readonly placed: Placed[];
  private readonly shares: Float64Array | null;
  private readonly morphShares: Float64Array | null = null;
  private readonly allowed: Record<Field, boolean>;
  /** Everything that any of its clips drives. */
  private readonly driven: Record<Field, Int32Array>;

  constructor(
    readonly layer: EditLayer,
    source: Source,
    private readonly rig: Rig,
    morphNames: readonly string[],
  ) {
    this.placed = layer.placements
      .filter((p) => !p.muted && source.clips.has(p.animation))
      .map((placement) => {
        const clip = source.clips.get(placement.animation)!;
        return { placement, clip, bound: bound(clip, rig, morphNames) };
      })
      .sort((a, b) => a.placement.start - b.placement.start);
    const named = Object.keys(layer.joints).length > 0;
    const share = (names: readonly string[]) => (named ? Float64Array.from(names, (name) => layer.joints[name] ?? 0) : null);
    this.shares = share(rig.names);
    const numbers = [...morphNames, ...rig.attributes];
    this.morphShares = share(numbers);
    const may = (...properties: string[]) => layer.properties === null || properties.some((p) => (layer.properties as readonly string[]).includes(p));
    this.allowed = { translations: may("translation"), rotations: may("rotation", "euler"), scales: may("scale"), morphs: may("weight", "value") };
    if (layer.properties !== null && this.allowed.morphs) {
      const own = (this.morphShares ??= new Float64Array(numbers.length).fill(1));
      if (!may("weight")) own.fill(0, 0, morphNames.length);
      if (!may("value")) own.fill(0, morphNames.length);
    }
    const all = (field: Field) =>
      this.placed.length === 1 ? this.placed[0].bound[field] : Int32Array.from(new Set(this.placed.flatMap((p) => [...p.bound[field]])));
    this.driven = { translations: all("translations"), rotations: all("rotations"), scales: all("scales"), morphs: all("morphs") };
  }

  influence(time: number): number {
    const { influence } = this.layer;
    return typeof influence === "number" ? influence : Math.max(0, Math.min(1, number(influence, time)));
  }

  /** The weight of the placement that is active last. */
  lastWeight(time: number): number {
    let last = 1;
    this.active(time, (_, __, weight) => (last = weight));
    return last;
  }

  private active(time: number, visit: (placed: Placed, own: number, weight: number) => void): void {
    this.placed.forEach((placed, n) => {
      // only the first placement reaches back before its start
      if (n > 0 && time < placed.placement.start) return;
      const { own, weight } = placementTime(placed.placement, placed.clip, time);
      if (weight > 0) visit(placed, own, weight);
    });
  }

  share(joint: number): number {
    return this.shares ? this.shares[joint] : 1;
  }

  allows(field: Field): boolean {
    return this.allowed[field];
  }

  /** Lay the layer over a pose. */
  join(time: number, pose: Pose, drive: Drive, scratch: Pose): void {
    const influence = this.influence(time);
    if (this.fully(influence)) {
      this.active(time, ({ bound }, own) => bound.apply(own, pose));
      return;
    }
    this.gather(time, drive, scratch);
    this.applyDrive(pose, drive);
  }

  /** Whether it simply takes the place of what lies below. */
  private fully(influence: number): boolean {
    const { layer, placed } = this;
    if (influence !== 1 || layer.mode !== "replace" || this.shares || layer.properties !== null || placed.length !== 1) return false;
    const { placement } = placed[0];
    return placement.hold && !placement.weight && placement.fadeIn === 0 && placement.fadeOut === 0;
  }

  /** What it wants at a time, and how strongly. */
  gather(time: number, drive: Drive, scratch: Pose): void {
    const { rig, driven, allowed } = this;
    for (const field of ["translations", "rotations", "scales", "morphs"] as const) for (const n of driven[field]) drive[field][n] = 0;
    this.active(time, ({ bound }, own, weight) => {
      scratch.copy(rig.rest);
      bound.apply(own, scratch);
      for (const field of ["translations", "scales", "morphs"] as const) {
        const a = allowed[field] ? weight : 0;
        for (const n of bound[field]) {
          const before = drive[field][n], amount = a + before * (1 - a);
          const u = amount > 0 ? a / amount : 0;
          drive.value[field][n] = before > 0 ? mix(drive.value[field][n], scratch[field][n], u) : scratch[field][n];
          drive[field][n] = amount;
        }
      }
      const a = allowed.rotations ? weight : 0;
      for (const joint of bound.rotations) {
        const before = drive.rotations[joint], amount = a + before * (1 - a);
        const q = 4 * joint;
        if (before > 0) turn(drive.value.rotations, q, scratch.rotations, q, amount > 0 ? a / amount : 0, drive.value.rotations, q);
        else for (let c = 0; c < 4; c++) drive.value.rotations[q + c] = scratch.rotations[q + c];
        drive.rotations[joint] = amount;
      }
    });
    const influence = this.influence(time);
    for (const n of driven.translations) drive.translations[n] *= influence * this.share(Math.floor(n / 3));
    for (const n of driven.scales) drive.scales[n] *= influence * this.share(Math.floor(n / 3));
    for (const n of driven.rotations) drive.rotations[n] *= influence * this.share(n);
    for (const n of driven.morphs) drive.morphs[n] *= influence * (this.morphShares ? this.morphShares[n] : 1);
  }

  private applyDrive(pose: Pose, drive: Drive): void {
    const { driven, rig } = this;
    const adds = this.layer.mode === "add";
    for (const field of ["translations", "morphs"] as const)
      for (const n of driven[field]) {
        const u = drive[field][n], v = drive.value[field][n];
        pose[field][n] = adds ? pose[field][n] + u * (v - rig.rest[field][n]) : mix(pose[field][n], v, u);
      }
    for (const n of driven.scales) {
      const u = drive.scales[n], v = drive.value.scales[n];
      pose.scales[n] = adds ? pose.scales[n] * (1 + u * (ratio(v, rig.rest.scales[n]) - 1)) : mix(pose.scales[n], v, u);
    }
    for (const joint of driven.rotations) {
      const q = 4 * joint, u = drive.rotations[joint];
      if (!adds) turn(pose.rotations, q, drive.value.rotations, q, u, pose.rotations, q);
      else {
        conjugateMultiply(rig.rest.rotations, q, drive.value.rotations, q, four, 0);
        powerShort(four, 0, u, four, 0);
        multiply(pose.rotations, q, four, 0, pose.rotations, q);
        normalize(pose.rotations, q);
      }
    }
  }
}

const four = new Float64Array(4), other = new Float64Array(4);

const mix = (a: number, b: number, u: number) => (u < 0.5 ? a + u * (b - a) : b - (1 - u) * (b - a));
const ratio = (value: number, reference: number) => (reference === 0 ? 1 : value / reference);

/** slerp, exactly a or b at the ends. */
function turn(a: Float64Array, i: number, b: Float64Array, j: number, u: number, out: Float64Array, o: number): void {
  if (u === 0 || u === 1) {
    const from = u === 0 ? a : b, at = u === 0 ? i : j;
    for (let c = 0; c < 4; c++) out[o + c] = from[at + c];
  } else slerp(a, i, b, j, u, out, o);
}

// ---- timelines -----------------------------------------------------------------------------------------------------

/** What to key on a layer so that the whole timeline gives a wanted local transform, and whether the layer can do that. */
export interface KeyedValue {
  translation: number[];
  rotation: number[];
  scale: number[];
  reachable: { translation: boolean; rotation: boolean; scale: boolean };
}

/** A timeline over one rig. */
export class BoundTimeline implements Binding {
  readonly morphs: ReadonlySet<number>;
  private readonly layers: BoundLayer[];
  private readonly drive: Drive;
  private readonly scratch: Pose;

  constructor(
    private readonly source: Source,
    readonly timeline: EditTimeline,
    private readonly rig: Rig,
    private readonly morphNames: readonly string[],
  ) {
    const open = timeline.layers.filter((l) => !l.muted);
    const solo = open.filter((l) => l.solo);
    this.layers = (solo.length > 0 ? solo : open).map((l) => new BoundLayer(l, source, rig, morphNames));
    this.drive = new Drive(rig.count, rig.rest.morphs.length);
    this.scratch = rig.newPose();
    const morphs = new Set<number>();
    for (const { placements } of timeline.layers)
      for (const { animation } of placements)
        for (const { channel } of source.clips.get(animation)?.curves.values() ?? [])
          if (channel.property === "weight") morphs.add(morphNames.indexOf(channel.target));
    morphs.delete(-1);
    this.morphs = morphs;
  }

  apply(time: number, pose: Pose): void {
    pose.copy(this.rig.rest);
    const shown = exposedTime(this.timeline, time);
    for (const layer of this.layers) layer.join(shown, pose, this.drive, this.scratch);
  }

  /** See keypose.evaluate.value_for_result; wanted is the local transform of one joint. */
  valueForResult(
    layerName: string,
    time: number,
    joint: number,
    wanted: { translation: ArrayLike<number>; rotation: ArrayLike<number>; scale: ArrayLike<number> },
  ): KeyedValue {
    const { rig, timeline } = this;
    const shown = exposedTime(timeline, time);
    const model = timeline.layers.find((l) => l.name === layerName);
    const own = this.layers.find((l) => l.layer === model) ?? (model ? new BoundLayer(model, this.source, rig, this.morphNames) : null);
    if (!own) throw new Error(`no layer '${layerName}'`);
    const below = rig.newPose();
    below.copy(rig.rest);
    const t = Float64Array.from(wanted.translation), r = Float64Array.from(wanted.rotation), s = Float64Array.from(wanted.scale);
    const reachable = { translation: true, rotation: true, scale: true };
    const at = timeline.layers.indexOf(own.layer);
    const above = this.layers.filter((l) => timeline.layers.indexOf(l.layer) > at).reverse();
    for (const layer of this.layers) if (timeline.layers.indexOf(layer.layer) < at) layer.join(shown, below, this.drive, this.scratch);
    for (const layer of above) this.undo(layer, shown, joint, t, r, s, reachable);
    const amount = own.lastWeight(shown) * own.influence(shown) * own.share(joint);
    const adds = own.layer.mode === "add";
    const i = 3 * joint, q = 4 * joint;
    const rest = rig.rest;
    const solve = (field: Field) => {
      const u = own.allows(field) ? amount : 0;
      if (u === 0) reachable[field === "translations" ? "translation" : field === "scales" ? "scale" : "rotation"] = false;
      return u > 0 ? u : 1;
    };
    let u = solve("translations");
    for (let c = 0; c < 3; c++) {
      const from = below.translations[i + c];
      t[c] = (adds ? rest.translations[i + c] : from) + (t[c] - from) / u;
    }
    u = solve("scales");
    for (let c = 0; c < 3; c++) {
      const from = below.scales[i + c];
      if (adds && from === 0) reachable.scale = false;
      s[c] = adds ? rest.scales[i + c] * (1 + (ratio(s[c], from) - 1) / u) : from + (s[c] - from) / u;
    }
    u = solve("rotations");
    conjugateMultiply(below.rotations, q, r, 0, four, 0);
    powerShort(four, 0, 1 / u, four, 0);
    multiply(adds ? rest.rotations : below.rotations, q, four, 0, r, 0);
    normalize(r, 0);
    return { translation: [...t], rotation: [...r], scale: [...s], reachable };
  }

  /** Take a layer off a joint's transform: what must lie below it. */
  private undo(layer: BoundLayer, time: number, joint: number, t: Float64Array, r: Float64Array, s: Float64Array, reachable: KeyedValue["reachable"]): void {
    const { drive, rig } = this;
    const i = 3 * joint, q = 4 * joint;
    for (let c = 0; c < 3; c++) drive.translations[i + c] = drive.scales[i + c] = 0;
    drive.rotations[joint] = 0;
    layer.gather(time, drive, this.scratch);
    const { value } = drive;
    const adds = layer.layer.mode === "add";
    for (let c = 0; c < 3; c++) {
      let u = drive.translations[i + c], v = value.translations[i + c];
      if (u > 0) {
        if (adds) t[c] -= u * (v - rig.rest.translations[i + c]);
        else if (u < 1) t[c] = v + (t[c] - v) / (1 - u);
        else reachable.translation = false;
      }
      u = drive.scales[i + c];
      v = value.scales[i + c];
      if (u > 0) {
        const factor = 1 + u * (ratio(v, rig.rest.scales[i + c]) - 1);
        if (adds && factor !== 0) s[c] /= factor;
        else if (!adds && u < 1) s[c] = v + (s[c] - v) / (1 - u);
        else reachable.scale = false;
      }
    }
    const u = drive.rotations[joint];
    if (u === 0) return;
    if (adds) {
      conjugateMultiply(rig.rest.rotations, q, value.rotations, q, four, 0);
      powerShort(four, 0, -u, four, 0);
      multiply(r, 0, four, 0, r, 0);
    } else if (u < 1) {
      for (let c = 0; c < 4; c++) other[c] = value.rotations[q + c];
      conjugateMultiply(other, 0, r, 0, four, 0);
      powerShort(four, 0, 1 / (1 - u), four, 0);
      multiply(other, 0, four, 0, r, 0);
    } else reachable.rotation = false;
    normalize(r, 0);
  }
}

const timelines = new WeakMap<EditTimeline, WeakMap<Rig, { clips: unknown; bound: BoundTimeline }>>();

/** The timeline of a document over a rig; the same object as long as neither timeline nor clips have changed. */
export function bindTimeline(source: Source, name: string, rig: Rig, morphNames: readonly string[]): BoundTimeline | null {
  const timeline = source.timelines.get(name);
  if (!timeline) return null;
  let rigs = timelines.get(timeline);
  if (!rigs) timelines.set(timeline, (rigs = new WeakMap()));
  const kept = rigs.get(rig);
  if (kept && kept.clips === source.clips) return kept.bound;
  const made = new BoundTimeline(source, timeline, rig, morphNames);
  rigs.set(rig, { clips: source.clips, bound: made });
  return made;
}
