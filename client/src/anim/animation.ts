// Animations as the server sends them, and their binding to the joints and morphs of one character by name.

import type { ClipData, MotionData } from "../generated/messages";
import type { Arrays } from "../net/container";
import { Curve } from "./curve";
import { matchNames } from "./matching";
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
    return (matchNames(this.joints, rig.names).size + shapes) / total;
  }
}

type Field = "translations" | "rotations" | "scales" | "morphs";
const FIELDS: Record<string, [Field, number]> = {
  translation: ["translations", 3],
  rotation: ["rotations", 4],
  scale: ["scales", 3],
  weight: ["morphs", 1],
};

export class ClipAnimation extends Animation {
  readonly kind = "clip";
  readonly joints: ReadonlySet<string>;
  readonly morphNames: ReadonlySet<string>;
  private readonly curves: { target: string; field: Field; width: number; curve: Curve }[];
  private readonly keyCache = new Map<string | null, Float64Array>();

  constructor(data: ClipData, arrays: Arrays, sceneId: string, index: number) {
    super(data, sceneId, index);
    this.curves = data.curves.map((c) => {
      const [field, width] = FIELDS[c.property];
      const optional = (ref: typeof c.in_tangents) => (ref ? arrays.floats(ref) : null);
      const curve = new Curve(
        {
          times: arrays.float64(c.times),
          values: arrays.floats(c.values),
          modes: arrays.uint8(c.modes),
          inTangents: optional(c.in_tangents),
          outTangents: optional(c.out_tangents),
          before: c.before,
          after: c.after,
        },
        c.property === "rotation",
      );
      return { target: c.target, field, width, curve };
    });
    const targets = (morphs: boolean) => this.curves.filter((c) => (c.field === "morphs") === morphs).map((c) => c.target);
    this.joints = new Set(targets(false));
    this.morphNames = new Set(targets(true));
  }

  bind(rig: Rig, morphNames: string[]): Binding {
    const tracks: { field: Field; at: number; curve: Curve }[] = [];
    const morphs = new Set<number>();
    const own = new Map([...matchNames(this.joints, rig.names)].map(([name, source]) => [source, rig.index(name)]));
    for (const { target, field, width, curve } of this.curves) {
      const index = field === "morphs" ? morphNames.indexOf(target) : (own.get(target) ?? -1);
      if (index < 0) continue;
      if (field === "morphs") morphs.add(index);
      // a curve keeps its own place between frames, so each binding has its own
      tracks.push({ field, at: index * width, curve: new Curve(curve.data, field === "rotations") });
    }
    return {
      morphs,
      apply(time, pose) {
        pose.copy(rig.rest);
        for (let n = 0; n < tracks.length; n++) {
          const track = tracks[n];
          track.curve.sample(time, pose[track.field], track.at);
        }
      },
    };
  }

  keyTimes(rig: Rig, joint: number | null): Float64Array {
    const target = joint === null ? null : (matchNames(this.joints, rig.names).get(rig.names[joint]) ?? "");
    let times = this.keyCache.get(target);
    if (!times) {
      const all = new Set<number>();
      for (const c of this.curves)
        if (target === null || (c.field !== "morphs" && c.target === target)) for (const t of c.curve.data.times) all.add(t);
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
    const joint = Int32Array.from([...matchNames(data.joint_names, rig.names)].flatMap(([name, source]) => [row.get(source)!, rig.index(name)]));
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
