// The mirror image of a pose, for any directions of the joints' own axes: what each joint turned away from its rest, seen
// in the character's space, is reflected and given to the joint of the other side.

import type { Rig } from "../../anim/rig";
import type { StoredPose } from "../contract";
import { mirrorPairs } from "./sides";
import { add, dot, inverse, length, normal, product, rotated, scaled, subtract, unit, type Quat, type Vec } from "./spaces";

export type StoredJoint = StoredPose["joints"][string];

export class Mirror {
  /** The normal of the plane between left and right, a unit vector. */
  readonly normal: Vec;
  private readonly pairs: Map<string, string>;
  /** Rotations of the rest pose from each joint to the character's space, without scale. */
  private readonly rest: Quat[];

  constructor(
    private readonly rig: Rig,
    private readonly morphNames: readonly string[],
  ) {
    this.pairs = mirrorPairs(rig.names);
    this.rest = [];
    for (let joint = 0; joint < rig.count; joint++) {
      const own = rest4(rig, joint), parent = rig.parents[joint];
      this.rest.push(parent < 0 ? own : normal(product(this.rest[parent], own)));
    }
    this.normal = this.findNormal();
  }

  /** From right to left, by where the pairs stand at rest; the side is X where nothing tells. */
  private findNormal(): Vec {
    const { rig } = this;
    const world = new Float64Array(12 * rig.count);
    rig.solve(rig.rest, world);
    const place = (name: string): Vec => [...world.subarray(12 * rig.index(name) + 9, 12 * rig.index(name) + 12)] as unknown as Vec;
    let sum: Vec = [0, 0, 0];
    for (const [name, other] of this.pairs) {
      if (name === other) continue;
      const apart = subtract(place(name), place(other));
      sum = add(sum, dot(apart, sum) < 0 ? scaled(apart, -1) : apart);
    }
    const found = length(sum) > 1e-9 ? unit(sum) : ([1, 0, 0] as const);
    // small differences between the sides do not tilt the plane
    for (let axis = 0; axis < 3; axis++)
      if (Math.abs(found[axis]) > 0.995) return [0, 1, 2].map((n) => Number(n === axis)) as unknown as Vec;
    return found;
  }

  /** The joint on the other side; null where there is none. */
  other(name: string): string | null {
    return this.pairs.get(name) ?? null;
  }

  private reflected(v: Vec): Vec {
    return subtract(v, scaled(this.normal, 2 * dot(v, this.normal)));
  }

  /** A rotation seen in the mirror: its axis is reflected, and turns the other way. */
  private reflectedTurn(q: Quat): Quat {
    const axis = this.reflected([q[1], q[2], q[3]]);
    return [q[0], -axis[0], -axis[1], -axis[2]];
  }

  private parentRest(joint: number): Quat {
    const parent = this.rig.parents[joint];
    return parent < 0 ? [1, 0, 0, 0] : this.rest[parent];
  }

  /** What the joint of the other side holds in the mirror image. */
  joint(name: string, local: StoredJoint): { name: string; local: StoredJoint } | null {
    const { rig } = this;
    const otherName = this.other(name);
    if (otherName === null) return null;
    const from = rig.index(name), to = rig.index(otherName);
    // rotation: away from rest, in the character's space as the parent's rest orientation shows it
    const away = product(product(this.parentRest(from), local.rotation as unknown as Quat), inverse(this.rest[from]));
    const rotation = normal(product(product(inverse(this.parentRest(to)), this.reflectedTurn(away)), this.rest[to]));
    const moved = subtract(local.translation as unknown as Vec, rest3(rig, from));
    const seen = this.reflected(rotated(this.parentRest(from), moved));
    const translation = add(rest3(rig, to), rotated(inverse(this.parentRest(to)), seen));
    return { name: otherName, local: { translation: [...translation], rotation: [...rotation], scale: this.scale(from, to, local.scale) } };
  }

  /** Scales belong to the joint's own axes: each goes to the axis of the other joint that lies like its mirror image. */
  private scale(from: number, to: number, scale: readonly number[]): number[] {
    const out = [1, 1, 1];
    const free = new Set([0, 1, 2]);
    for (let n = 0; n < 3; n++) {
      const axis = [0, 1, 2].map((c) => Number(c === n)) as unknown as Vec;
      const seen = rotated(inverse(this.rest[to]), this.reflected(rotated(this.rest[from], axis)));
      const best = [...free].reduce((a, b) => (Math.abs(seen[b]) > Math.abs(seen[a]) ? b : a));
      free.delete(best);
      const before = this.rig.rest.scales[3 * from + n], after = this.rig.rest.scales[3 * to + best];
      out[best] = before !== 0 ? (scale[n] / before) * after : after;
    }
    return out;
  }

  /** The mirror image of a pose; joints that have no other side are left out. */
  pose(pose: StoredPose): StoredPose {
    const joints: Record<string, StoredJoint> = {};
    for (const [name, local] of Object.entries(pose.joints)) {
      if (this.rig.index(name) < 0) continue;
      const image = this.joint(name, local);
      if (image) joints[image.name] = image.local;
    }
    // morphs of one side alone have a counterpart all the same
    const names = Object.keys(pose.morphs), pairs = mirrorPairs([...new Set([...names, ...this.morphNames])]);
    const morphs: Record<string, number> = {};
    for (const name of names) morphs[pairs.get(name) ?? name] = pose.morphs[name];
    return { name: pose.name, joints, morphs };
  }
}

const rest3 = (rig: Rig, joint: number): Vec => [...rig.rest.translations.subarray(3 * joint, 3 * joint + 3)] as unknown as Vec;
const rest4 = (rig: Rig, joint: number): Quat => normal([...rig.rest.rotations.subarray(4 * joint, 4 * joint + 4)] as unknown as Quat);

const mirrors = new WeakMap<Rig, Mirror>();

export function mirrorOf(rig: Rig, morphNames: readonly string[]): Mirror {
  let mirror = mirrors.get(rig);
  if (!mirror) mirrors.set(rig, (mirror = new Mirror(rig, morphNames)));
  return mirror;
}
