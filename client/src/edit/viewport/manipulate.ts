// What moving, turning and scaling joints in space means for their local transforms. Pure: a pose in, local values out.

import type { Pose, Rig } from "../../anim/rig";
import {
  add,
  along,
  columnsOf,
  determinant,
  dot,
  IDENTITY,
  length,
  nearestOrthonormal,
  normal,
  placeOf,
  product,
  rotated,
  scaled,
  solve,
  subtract,
  turn,
  within,
  type Basis,
  type Quat,
  type Vec,
} from "./spaces";

export type Mode = "move" | "rotate" | "scale";
export type Space = "global" | "local" | "parent";
/** Each joint about itself, or all about one point. */
export type Pivot = "individual" | "common";

/** The pose that a manipulation starts from. */
export interface Start {
  readonly rig: Rig;
  readonly pose: Pose;
  readonly world: Float64Array;
}

export interface Setting {
  readonly space: Space;
  readonly pivot: Pivot;
  /** Whether joints that hang on others may be moved away from where their bones end. */
  readonly detach: boolean;
}

/** Local values by joint: only what changes. */
export interface Local {
  translation?: Vec;
  rotation?: Quat;
  scale?: Vec;
}
export type Locals = Map<number, Local>;

export function startOf(rig: Rig, pose: Pose, world: Float64Array): Start {
  const copy = { translations: pose.translations.slice(), rotations: pose.rotations.slice(), scales: pose.scales.slice(), morphs: pose.morphs.slice(), controls: pose.controls, frames: pose.frames };
  return { rig, pose: copy as Pose, world: world.slice() };
}

export const translationOf = ({ pose }: Start, joint: number): Vec => [...pose.translations.subarray(3 * joint, 3 * joint + 3)] as unknown as Vec;
export const rotationOf = ({ pose }: Start, joint: number): Quat => [...pose.rotations.subarray(4 * joint, 4 * joint + 4)] as unknown as Quat;
export const scaleOf = ({ pose }: Start, joint: number): Vec => [...pose.scales.subarray(3 * joint, 3 * joint + 3)] as unknown as Vec;

/** model_from_parent without its translation; the identity for roots. */
export function parentColumns({ rig, pose, world }: Start, joint: number): Basis {
  if (joint >= rig.jointCount && pose.frames) return columnsOf(pose.frames, joint - rig.jointCount);
  const parent = rig.parents[joint];
  return parent < 0 ? IDENTITY : columnsOf(world, parent);
}

/** Those that hang on no other of them: what moves one moves all below it. */
export function topmost(rig: Rig, joints: readonly number[]): number[] {
  const chosen = new Set(joints);
  return joints.filter((joint) => {
    for (let p = rig.parents[joint]; p >= 0; p = rig.parents[p]) if (chosen.has(p)) return false;
    return true;
  });
}

/** The directions of a space as a joint has it, orthonormal, in the character's space. */
export function axesOf(start: Start, joint: number, space: Space): Basis {
  if (space === "global" || joint < 0) return IDENTITY;
  if (space === "parent") return nearestOrthonormal(parentColumns(start, joint));
  return nearestOrthonormal(columnsOf(start.world, joint));
}

/** The point that all turn and scale about: the middle of those that move. */
export function pivotOf(start: Start, joints: readonly number[], pivot: Pivot): Vec {
  const active = joints.at(-1);
  if (active === undefined) return [0, 0, 0];
  if (pivot === "individual") return placeOf(start.world, active);
  const tops = topmost(start.rig, joints);
  return scaled(tops.map((j) => placeOf(start.world, j)).reduce(add), 1 / tops.length);
}

export const canMove = (rig: Rig, joint: number, { detach }: Setting): boolean => detach || rig.parents[joint] < 0 || joint >= rig.jointCount;

/** The local translation that puts a joint at a place of the character's space. */
function translationTo(start: Start, joint: number, delta: Vec): Vec | null {
  const local = solve(parentColumns(start, joint), delta);
  return local && add(translationOf(start, joint), local);
}

/** Move by components along the axes of the space; each joint along its own where they turn individually. */
export function move(start: Start, joints: readonly number[], amount: Vec, setting: Setting): Locals {
  const out: Locals = new Map();
  const active = joints.at(-1) ?? -1;
  for (const joint of topmost(start.rig, joints)) {
    if (!canMove(start.rig, joint, setting)) continue;
    const axes = axesOf(start, setting.pivot === "individual" ? joint : active, setting.space);
    const translation = translationTo(start, joint, along(axes, amount));
    if (translation) out.set(joint, { translation });
  }
  return out;
}

/**
 * The axis that a joint's local rotation turns about, so that its body turns about an axis of the character's space.
 * Behind a mirrored parent everything turns the other way round.
 */
function localAxis(parent: Basis, axis: Vec): Vec {
  const turned = nearestOrthonormal(parent);
  return scaled(within(turned, axis), Math.sign(determinant(turned)));
}

export type Axis = 0 | 1 | 2;

/** Turn by radians about an axis of the space (a number) or of the character's space (a vector, the same for all). */
export function rotate(start: Start, joints: readonly number[], axis: Axis | Vec, angle: number, setting: Setting): Locals {
  const out: Locals = new Map();
  const active = joints.at(-1) ?? -1;
  const common = setting.pivot === "common";
  const centre = pivotOf(start, joints, setting.pivot);
  for (const joint of common ? topmost(start.rig, joints) : joints) {
    const parent = parentColumns(start, joint), q = rotationOf(start, joint);
    const own = typeof axis === "number" ? axesOf(start, common ? active : joint, setting.space)[axis] : axis;
    let about = localAxis(parent, own);
    // about its own axis exactly, though a parent's uneven scale bends what it looks like
    if (typeof axis === "number" && setting.space === "local" && (!common || joint === active))
      about = scaled(rotated(q, IDENTITY[axis]), Math.sign(determinant(nearestOrthonormal(parent))) || 1);
    const local: Local = { rotation: normal(product(turn(about, angle), q)) };
    if (common && canMove(start.rig, joint, setting)) {
      const from = subtract(placeOf(start.world, joint), centre);
      const translation = translationTo(start, joint, subtract(rotated(turn(own, angle), from), from));
      if (translation) local.translation = translation;
    }
    out.set(joint, local);
  }
  return out;
}

/** Scale by factors along the axes of the space. A joint has scales along its own axes alone, so each takes what it sees of it. */
export function scale(start: Start, joints: readonly number[], factors: Vec, setting: Setting): Locals {
  const out: Locals = new Map();
  const active = joints.at(-1) ?? -1;
  const common = setting.pivot === "common";
  const centre = pivotOf(start, joints, setting.pivot);
  const even = factors[0] === factors[1] && factors[1] === factors[2];
  for (const joint of common ? topmost(start.rig, joints) : joints) {
    const axes = axesOf(start, common ? active : joint, setting.space), before = scaleOf(start, joint);
    const mine = nearestOrthonormal(columnsOf(start.world, joint));
    const stretched = (v: Vec) => along(axes, within(axes, v).map((c, n) => c * factors[n]) as unknown as Vec);
    const factor = (n: number) => {
      if (even || (setting.space === "local" && !common)) return factors[n];
      const to = stretched(mine[n]);
      return length(to) * (dot(to, mine[n]) < 0 ? -1 : 1);
    };
    const local: Local = { scale: [before[0] * factor(0), before[1] * factor(1), before[2] * factor(2)] };
    if (common && canMove(start.rig, joint, setting)) {
      const from = subtract(placeOf(start.world, joint), centre);
      const translation = translationTo(start, joint, subtract(stretched(from), from));
      if (translation) local.translation = translation;
    }
    out.set(joint, local);
  }
  return out;
}
