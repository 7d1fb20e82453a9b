// The joints of a character: rest pose, current local pose, and forward kinematics.

import type { SkeletonData } from "../generated/messages";
import type { Arrays } from "../net/container";

/** Local transforms of all joints and the morph weights: what an animation writes. */
export class Pose {
  readonly translations: Float64Array;
  readonly rotations: Float64Array;
  readonly scales: Float64Array;
  readonly morphs: Float64Array;
  /** Of the controls of a rig, where there is one: model_from_control and what each one's local transform is relative to, 12 numbers each. */
  controls: Float64Array | null = null;
  frames: Float64Array | null = null;

  constructor(joints: number, morphs: number) {
    this.translations = new Float64Array(3 * joints);
    this.rotations = new Float64Array(4 * joints);
    this.scales = new Float64Array(3 * joints).fill(1);
    this.morphs = new Float64Array(morphs);
  }

  copy(other: Pose): void {
    this.translations.set(other.translations);
    this.rotations.set(other.rotations);
    this.scales.set(other.scales);
    this.morphs.set(other.morphs);
    this.controls = other.controls;
    this.frames = other.frames;
  }
}

export class Rig {
  readonly names: string[];
  readonly parents: Int32Array;
  readonly count: number;
  /** The joints of the body; what follows are the controls of its rig. */
  readonly jointCount: number;
  readonly rest: Pose;
  readonly pose: Pose;
  /** model_from_joint: per joint three axes and the position, 12 numbers. */
  readonly world: Float64Array;
  readonly children: number[][];
  readonly ends = new Map<number, [number, number, number]>();
  private readonly byName: Map<string, number>;

  /** Numbers of a rig by name; in a pose they follow the weights of morphs. */
  readonly attributes: readonly string[];

  constructor(data: SkeletonData, arrays: Arrays, morphs: ArrayLike<number>, attributes: Readonly<Record<string, number>> = {}) {
    const restMorphs = [...Array.from(morphs), ...Object.values(attributes)];
    this.attributes = Object.keys(attributes);
    this.names = data.names;
    this.parents = arrays.int32(data.parents);
    this.count = data.names.length;
    this.jointCount = this.count - data.controls;
    this.rest = new Pose(this.count, restMorphs.length);
    this.rest.translations.set(arrays.float64(data.translations));
    this.rest.rotations.set(arrays.float64(data.rotations));
    this.rest.scales.set(arrays.float64(data.scales));
    this.rest.morphs.set(restMorphs);
    this.pose = new Pose(this.count, restMorphs.length);
    this.pose.copy(this.rest);
    this.world = new Float64Array(12 * this.count);
    this.children = this.names.map(() => []);
    this.parents.forEach((parent, joint) => parent >= 0 && this.children[parent].push(joint));
    const offsets = arrays.float32(data.end_offsets);
    data.end_joints.forEach((joint, n) => this.ends.set(joint, [offsets[3 * n], offsets[3 * n + 1], offsets[3 * n + 2]]));
    this.byName = new Map(this.names.map((name, joint) => [name, joint]));
    this.solve();
  }

  /** A pose for this rig. */
  newPose(): Pose {
    return new Pose(this.count, this.rest.morphs.length);
  }

  /** Where the number of an attribute is among the morphs of a pose, or -1. */
  attributeIndex(name: string): number {
    const n = this.attributes.indexOf(name);
    return n < 0 ? -1 : this.rest.morphs.length - this.attributes.length + n;
  }

  index(name: string): number {
    return this.byName.get(name) ?? -1;
  }

  /** Forward kinematics of the current pose into `world` (or another array, for ghosts and read-outs). */
  solve(pose: Pose = this.pose, world: Float64Array = this.world): void {
    const { translations: t, rotations: r, scales: s } = pose;
    const { parents, count } = this;
    for (let joint = 0; joint < count; joint++) {
      const i3 = 3 * joint, i4 = 4 * joint, o = 12 * joint;
      const w = r[i4], x = r[i4 + 1], y = r[i4 + 2], z = r[i4 + 3];
      const sx = s[i3], sy = s[i3 + 1], sz = s[i3 + 2];
      const xx = (1 - 2 * (y * y + z * z)) * sx, xy = 2 * (x * y + w * z) * sx, xz = 2 * (x * z - w * y) * sx;
      const yx = 2 * (x * y - w * z) * sy, yy = (1 - 2 * (x * x + z * z)) * sy, yz = 2 * (y * z + w * x) * sy;
      const zx = 2 * (x * z + w * y) * sz, zy = 2 * (y * z - w * x) * sz, zz = (1 - 2 * (x * x + y * y)) * sz;
      const px = t[i3], py = t[i3 + 1], pz = t[i3 + 2];
      const parent = parents[joint];
      if (parent < 0) {
        world[o] = xx; world[o + 1] = xy; world[o + 2] = xz;
        world[o + 3] = yx; world[o + 4] = yy; world[o + 5] = yz;
        world[o + 6] = zx; world[o + 7] = zy; world[o + 8] = zz;
        world[o + 9] = px; world[o + 10] = py; world[o + 11] = pz;
        continue;
      }
      const p = 12 * parent;
      const ax = world[p], ay = world[p + 1], az = world[p + 2];
      const bx = world[p + 3], by = world[p + 4], bz = world[p + 5];
      const cx = world[p + 6], cy = world[p + 7], cz = world[p + 8];
      world[o] = ax * xx + bx * xy + cx * xz;
      world[o + 1] = ay * xx + by * xy + cy * xz;
      world[o + 2] = az * xx + bz * xy + cz * xz;
      world[o + 3] = ax * yx + bx * yy + cx * yz;
      world[o + 4] = ay * yx + by * yy + cy * yz;
      world[o + 5] = az * yx + bz * yy + cz * yz;
      world[o + 6] = ax * zx + bx * zy + cx * zz;
      world[o + 7] = ay * zx + by * zy + cy * zz;
      world[o + 8] = az * zx + bz * zy + cz * zz;
      world[o + 9] = ax * px + bx * py + cx * pz + world[p + 9];
      world[o + 10] = ay * px + by * py + cy * pz + world[p + 10];
      world[o + 11] = az * px + bz * py + cz * pz + world[p + 11];
    }
    // spaces and constraints put controls where the hierarchy alone does not
    if (pose.controls) world.set(pose.controls, 12 * this.jointCount);
  }
}

/** out = model_from_joint[palette] * joint_from_mesh as column-major 4x4 matrices, ready for the shader. */
export function writePalette(world: Float64Array, palette: Int32Array, inverse: Float32Array, out: Float32Array): void {
  for (let n = 0; n < palette.length; n++) {
    const p = 12 * palette[n], m = 16 * n;
    const ax = world[p], ay = world[p + 1], az = world[p + 2];
    const bx = world[p + 3], by = world[p + 4], bz = world[p + 5];
    const cx = world[p + 6], cy = world[p + 7], cz = world[p + 8];
    const dx = world[p + 9], dy = world[p + 10], dz = world[p + 11];
    // the inverse bind matrices arrive row-major
    for (let column = 0; column < 4; column++) {
      const u = inverse[m + column], v = inverse[m + 4 + column], w = inverse[m + 8 + column], h = inverse[m + 12 + column];
      const o = m + 4 * column;
      out[o] = ax * u + bx * v + cx * w + dx * h;
      out[o + 1] = ay * u + by * v + cy * w + dy * h;
      out[o + 2] = az * u + bz * v + cz * w + dz * h;
      out[o + 3] = h;
    }
  }
}
