// What the controls of a rig make of its joints. The server knows; the page asks it for one pose while something is moved,
// and for the whole timeline when that has come to rest.

import type { Pose, Rig } from "../../anim/rig";
import { slerp } from "../../anim/rotation";
import type { RigData, RigPosed, RigPoseRequest } from "../../generated/messages";
import { Arrays, Packer, type Container } from "../../net/container";

/** Ten numbers for a transform: translation, rotation wxyz, scale. */
const TEN = 10;

export type Wish = Pick<RigPoseRequest, "wish" | "modules" | "control" | "space">;
export const NO_WISH: Wish = { wish: "none", modules: [], control: "", space: 0 };

/** Frames of solved poses; one for an answer, all of a timeline for a track. */
export interface Solved {
  readonly frames: number;
  readonly start: number;
  readonly rate: number;
  readonly keyed: boolean;
  /** (frames, J, 10), and where controls are and what they are relative to, (frames, N, 4, 4) row by row. */
  readonly joints: Float64Array | Float32Array;
  readonly controls: Float64Array | Float32Array;
  readonly bases: Float64Array | Float32Array;
  /** What the wish made of the controls and numbers. */
  readonly wished: { readonly controls: Float64Array; readonly values: Float64Array } | null;
}

export function readSolved(container: Container<RigPosed>): Solved {
  const { header } = container, arrays = new Arrays(container);
  return {
    frames: header.joints.shape[0],
    start: header.start_s,
    rate: header.rate_hz,
    keyed: header.keyed,
    joints: arrays.floats(header.joints),
    controls: arrays.floats(header.model_from_control),
    bases: arrays.floats(header.model_from_frame),
    wished: header.controls && header.values ? { controls: arrays.float64(header.controls), values: arrays.float64(header.values) } : null,
  };
}

/** Local transforms of some joints of a pose, ten numbers each. */
export function transforms(pose: Pose, from: number, to: number): Float64Array {
  const out = new Float64Array(TEN * (to - from));
  for (let joint = from; joint < to; joint++) {
    const o = TEN * (joint - from);
    out.set(pose.translations.subarray(3 * joint, 3 * joint + 3), o);
    out.set(pose.rotations.subarray(4 * joint, 4 * joint + 4), o + 3);
    out.set(pose.scales.subarray(3 * joint, 3 * joint + 3), o + 7);
  }
  return out;
}

/** What a rig is asked: everything that its answer depends on. */
export class Question {
  readonly controls: Float64Array;
  readonly joints: Float64Array;
  readonly values: Float64Array;

  constructor(
    readonly data: RigData,
    rig: Rig,
    pose: Pose,
  ) {
    this.controls = transforms(pose, rig.jointCount, rig.count);
    this.joints = transforms(pose, 0, rig.jointCount);
    this.values = Float64Array.from(data.attributes, (a) => pose.morphs[rig.attributeIndex(a.name)]);
  }

  equals(other: Question): boolean {
    return this.data === other.data && same(this.controls, other.controls) && same(this.values, other.values) && same(this.joints, other.joints);
  }

  pack(wish: Wish): Uint8Array<ArrayBuffer> {
    const { data } = this, packer = new Packer();
    const header: RigPoseRequest = {
      type: "rig_pose",
      rig: data.name,
      controls: packer.add(this.controls, [1, this.controls.length / TEN, TEN]),
      joints: packer.add(this.joints, [1, this.joints.length / TEN, TEN]),
      values: packer.add(this.values, [1, this.values.length]),
      ...wish,
    };
    return packer.bytes(header);
  }
}

function same(a: Float64Array, b: Float64Array): boolean {
  if (a.length !== b.length) return false;
  for (let n = 0; n < a.length; n++) if (a[n] !== b[n]) return false;
  return true;
}

/** Row-by-row 4x4 matrices as three axes and a position each, the way `Rig.world` has them. */
function columns(rows: ArrayLike<number>, at: number, count: number, out: Float64Array): void {
  for (let n = 0; n < count; n++) {
    const i = at + 16 * n, o = 12 * n;
    for (let column = 0; column < 4; column++)
      for (let row = 0; row < 3; row++) out[o + 3 * column + row] = rows[i + 4 * row + column];
  }
}

function mixColumns(rows: ArrayLike<number>, a: number, b: number, u: number, count: number, out: Float64Array): void {
  for (let n = 0; n < count; n++)
    for (let column = 0; column < 4; column++)
      for (let row = 0; row < 3; row++) {
        const i = 16 * n + 4 * row + column;
        out[12 * n + 3 * column + row] = rows[a + i] + u * (rows[b + i] - rows[a + i]);
      }
}

const one = new Float64Array(4), two = new Float64Array(4);

/** Put the joints and controls of solved frames into a pose; between frames they are blended. */
export function writeSolved(solved: Solved, time: number, rig: Rig, pose: Pose): void {
  const { frames, joints, controls, bases } = solved;
  const J = rig.jointCount, N = rig.count - J;
  const exact = frames === 1 ? 0 : Math.max(0, Math.min(frames - 1, (time - solved.start) * solved.rate));
  // a frame's own time, to rounding, is the frame
  const near = Math.round(exact), at = Math.abs(exact - near) < 1e-5 ? near : exact;
  const first = Math.floor(at), u = at - first, next = u > 0 ? first + 1 : first;
  const size = TEN * J;
  for (let joint = 0; joint < J; joint++) {
    const a = first * size + TEN * joint, b = next * size + TEN * joint;
    for (let c = 0; c < 3; c++) {
      pose.translations[3 * joint + c] = joints[a + c] + u * (joints[b + c] - joints[a + c]);
      pose.scales[3 * joint + c] = joints[a + 7 + c] + u * (joints[b + 7 + c] - joints[a + 7 + c]);
    }
    for (let c = 0; c < 4; c++) {
      one[c] = joints[a + 3 + c];
      two[c] = joints[b + 3 + c];
    }
    if (u > 0) slerp(one, 0, two, 0, u, pose.rotations, 4 * joint);
    else pose.rotations.set(one, 4 * joint);
  }
  // arrays of its own: other poses keep theirs
  pose.controls = new Float64Array(12 * N);
  pose.frames = new Float64Array(12 * N);
  if (u > 0) {
    mixColumns(controls, 16 * N * first, 16 * N * next, u, N, pose.controls);
    mixColumns(bases, 16 * N * first, 16 * N * next, u, N, pose.frames);
  } else {
    columns(controls, 16 * N * first, N, pose.controls);
    columns(bases, 16 * N * first, N, pose.frames);
  }
}
