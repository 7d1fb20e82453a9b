// Animations as the server sends them, and their binding to the joints and morphs of one character by name.

import type { ClipData, CurveData, MotionData } from "../generated/messages";
import type { Arrays } from "../net/container";
import { Curve, type CurveArrays } from "./curve";
import { EULER_ORDER, eulerFromQuat, quatFromEuler } from "./euler";
import { matchRig } from "./matching";
import type { Pose, Rig } from "./rig";
import { slerp } from "./rotation";

/** An animation bound to a character: writes the pose of any time. */
export interface Binding {
  apply(time: number, pose: Pose): void;
  /** Morph channels that the animation drives. */
  readonly morphs: ReadonlySet<number>;
}

export abstract class Animation {
  readonly id: string;
  readonly name: string;
  readonly start: number;
  readonly duration: number;
  /** Frames per second of the read-out; 30 where the file does not say. */
  readonly rate: number;

  constructor(
    data: ClipData | MotionData,
    readonly sceneId: string,
    index: number,
  ) {
    this.id = `${sceneId}/${index}`;
    this.name = data.name || `animation ${index + 1}`;
    this.start = data.start_s;
    this.duration = data.duration_s;
    this.rate = data.rate_hz && data.rate_hz > 0 ? data.rate_hz : 30;
  }

  get end(): number {
    return this.start + this.duration;
  }

  /** Frames from the first to the last, both counted. */
  get frames(): number {
    return Math.round(this.duration * this.rate) + 1;
  }

  abstract readonly kind: "clip" | "motion";
  /** Joints that it moves, and morph channels. */
  abstract readonly joints: ReadonlySet<string>;
  abstract readonly morphNames: ReadonlySet<string>;
  abstract bind(rig: Rig, morphNames: string[]): Binding;
  /** Times of the keys of one joint of the rig, or of all. */
  abstract keyTimes(rig: Rig, joint: number | null): Float64Array;

  /** The share of what it animates that a character has. */
  match(rig: Rig, morphNames: string[]): number {
    const total = this.joints.size + this.morphNames.size;
    if (total === 0) return 0;
    const shapes = morphNames.filter((name) => this.morphNames.has(name)).length;
    return (matchRig(this.joints, rig).size + shapes) / total;
  }
}

type Field = "translations" | "rotations" | "scales" | "morphs";
const FIELDS: Record<string, [Field, number]> = {
  translation: ["translations", 3],
  rotation: ["rotations", 4],
  euler: ["rotations", 4],
  scale: ["scales", 3],
  weight: ["morphs", 1],
};

/** The arrays of a curve that the server sent. */
export function curveArrays(data: CurveData, arrays: Arrays): CurveArrays {
  const optional = (ref: CurveData["in_tangents"]) => (ref ? arrays.floats(ref) : null);
  return {
    kind: data.kind,
    times: arrays.float64(data.times),
    values: arrays.floats(data.values),
    modes: arrays.uint8(data.modes),
    inTangents: optional(data.in_tangents),
    outTangents: optional(data.out_tangents),
    inHandles: optional(data.in_handles),
    outHandles: optional(data.out_handles),
    before: data.before,
    after: data.after,
  };
}

/** What is bound: `apply` writes one joint's or morph's property of a pose. */
type Track = (time: number, pose: Pose) => void;

/** A joint's Euler angles: a whole curve, curves of single angles over it or over rest, and the order they turn in. */
function eulerTrack(joint: number, order: string, rest: Float64Array, whole: Curve | null, parts: (Curve | null)[]): Track {
  const still = new Float64Array(3), angles = new Float64Array(3);
  eulerFromQuat(rest, 4 * joint, order, still, 0);
  return (time, pose) => {
    if (whole) whole.sample(time, angles, 0);
    else angles.set(still);
    for (let c = 0; c < 3; c++) parts[c]?.sample(time, angles, c);
    quatFromEuler(angles, 0, order, pose.rotations, 4 * joint);
  };
}

interface BoundCurve {
  target: string;
  property: string;
  component: number | null;
  curve: Curve;
}

export class ClipAnimation extends Animation {
  readonly kind = "clip";
  readonly joints: ReadonlySet<string>;
  readonly morphNames: ReadonlySet<string>;
  private readonly curves: BoundCurve[];
  private readonly eulerOrders: Record<string, string>;
  private readonly keyCache = new Map<string | null, Float64Array>();

  constructor(data: ClipData, arrays: Arrays, sceneId: string, index: number) {
    super(data, sceneId, index);
    this.eulerOrders = data.euler_orders;
    this.curves = data.curves
      .filter((c) => c.property in FIELDS)
      .map((c) => ({ target: c.target, property: c.property, component: c.component, curve: new Curve(curveArrays(c, arrays)) }))
      // what drives one component goes over what drives them all
      .sort((a, b) => Number(a.component !== null) - Number(b.component !== null));
    const targets = (morphs: boolean) => this.curves.filter((c) => (c.property === "weight") === morphs).map((c) => c.target);
    this.joints = new Set(targets(false));
    this.morphNames = new Set(targets(true));
  }

  bind(rig: Rig, morphNames: string[]): Binding {
    const tracks: Track[] = [];
    const morphs = new Set<number>();
    const eulers = new Map<number, { order: string; whole: Curve | null; parts: (Curve | null)[] }>();
    const own = new Map([...matchRig(this.joints, rig)].map(([name, source]) => [source, rig.index(name)]));
    for (const { target, property, component, curve: shared } of this.curves) {
      const [field, width] = FIELDS[property];
      const index = field === "morphs" ? morphNames.indexOf(target) : (own.get(target) ?? -1);
      if (index < 0) continue;
      if (field === "morphs") morphs.add(index);
      // a curve keeps its own place between frames, so each binding has its own
      const curve = new Curve(shared.data);
      if (property === "euler") {
        let euler = eulers.get(index);
        if (!euler) eulers.set(index, (euler = { order: this.eulerOrders[target] ?? EULER_ORDER, whole: null, parts: [null, null, null] }));
        if (component === null) euler.whole = curve;
        else euler.parts[component] = curve;
        continue;
      }
      const at = index * width + (component ?? 0);
      tracks.push((time, pose) => curve.sample(time, pose[field], at));
    }
    for (const [joint, { order, whole, parts }] of eulers) tracks.push(eulerTrack(joint, order, rig.rest.rotations, whole, parts));
    return {
      morphs,
      apply(time, pose) {
        pose.copy(rig.rest);
        for (let n = 0; n < tracks.length; n++) tracks[n](time, pose);
      },
    };
  }

  keyTimes(rig: Rig, joint: number | null): Float64Array {
    const target = joint === null ? null : (matchRig(this.joints, rig).get(rig.names[joint]) ?? "");
    let times = this.keyCache.get(target);
    if (!times) {
      const all = new Set<number>();
      for (const c of this.curves)
        if (target === null || (c.property !== "weight" && c.target === target)) for (const t of c.curve.data.times) all.add(t);
      times = Float64Array.from(all).sort();
      this.keyCache.set(target, times);
    }
    return times;
  }
}

export class MotionAnimation extends Animation {
  readonly kind = "motion";
  readonly joints: ReadonlySet<string>;
  readonly morphNames: ReadonlySet<string>;
  private readonly arrays: { translations: Float32Array; rotations: Float32Array; scales: Float32Array };
  private readonly weights: Float32Array | null;

  constructor(
    private readonly data: MotionData,
    arrays: Arrays,
    sceneId: string,
    index: number,
  ) {
    super(data, sceneId, index);
    this.joints = new Set(data.joint_names);
    this.morphNames = new Set(data.morph_names);
    this.arrays = {
      translations: arrays.float32(data.translations),
      rotations: arrays.float32(data.rotations),
      scales: arrays.float32(data.scales),
    };
    this.weights = data.morph_weights ? arrays.float32(data.morph_weights) : null;
  }

  override get frames(): number {
    return this.data.frames;
  }

  bind(rig: Rig, morphNames: string[]): Binding {
    const { data, weights, start, rate } = this;
    const { translations, rotations, scales } = this.arrays;
    const joints = data.joint_names.length;
    const row = new Map(data.joint_names.map((name, n) => [name, n]));
    const joint = Int32Array.from([...matchRig(data.joint_names, rig)].flatMap(([name, source]) => [row.get(source)!, rig.index(name)]));
    const morph = Int32Array.from(
      (weights ? data.morph_names : []).flatMap((name, n) => (morphNames.includes(name) ? [n, morphNames.indexOf(name)] : [])),
    );
    const last = data.frames - 1;
    const strideT = translations.length > 3 * joints ? 3 * joints : 0;
    const strideR = rotations.length > 4 * joints ? 4 * joints : 0;
    const strideS = scales.length > 3 * joints ? 3 * joints : 0;
    return {
      morphs: new Set(morph.filter((_, n) => n % 2 === 1)),
      apply(time, pose) {
        pose.copy(rig.rest);
        const position = Math.max(0, Math.min(last, (time - start) * rate));
        // a time that was computed from a frame number lands on that frame exactly
        const rounded = Math.round(position);
        const frame = Math.abs(position - rounded) < 1e-7 ? rounded : Math.floor(position);
        const u = frame === rounded && Math.abs(position - rounded) < 1e-7 ? 0 : position - frame;
        const next = Math.min(frame + 1, last);
        const t0 = frame * strideT, t1 = next * strideT;
        const r0 = frame * strideR, r1 = next * strideR;
        const s0 = frame * strideS, s1 = next * strideS;
        for (let n = 0; n < joint.length; n += 2) {
          const s = joint[n], d = joint[n + 1];
          slerp(rotations, r0 + 4 * s, rotations, r1 + 4 * s, u, pose.rotations, 4 * d);
          for (let c = 0; c < 3; c++) {
            const a = translations[t0 + 3 * s + c], b = translations[t1 + 3 * s + c];
            pose.translations[3 * d + c] = a + u * (b - a);
            const e = scales[s0 + 3 * s + c], f = scales[s1 + 3 * s + c];
            pose.scales[3 * d + c] = e + u * (f - e);
          }
        }
        if (weights) {
          const m = data.morph_names.length;
          for (let n = 0; n < morph.length; n += 2) {
            const a = weights[frame * m + morph[n]], b = weights[next * m + morph[n]];
            pose.morphs[morph[n + 1]] = a + u * (b - a);
          }
        }
      },
    };
  }

  private times: Float64Array | null = null;

  keyTimes(): Float64Array {
    return (this.times ??= Float64Array.from({ length: this.data.frames }, (_, f) => this.start + f / this.rate));
  }
}
