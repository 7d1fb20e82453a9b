// Roles of joints: their names for people, where they lie on the drawn figure, and changes of a map of roles.

import type { RetargetRoles } from "../generated/messages";
import type { Rig } from "../anim/rig";
import { mirrorPairs } from "../edit/viewport/sides";

/** Role -> joint name. */
export type RoleTable = Readonly<Record<string, string>>;

export type Side = "left" | "right" | "";
export type Doubt = "sure" | "likely" | "unsure" | "set" | "needed" | "none";

const FINGERS = ["thumb", "index", "middle", "ring", "little"] as const;
const BONES = { thumb: ["metacarpal", "proximal", "distal"], other: ["proximal", "intermediate", "distal"] };
const LIMBS = ["shoulder", "upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot", "toes"] as const;
const SIDES = ["left", "right"] as const;

export interface Spot {
  role: string;
  /** On a figure 320 wide and 372 tall, seen from the front: its left is on the right. */
  x: number;
  y: number;
  small: boolean;
}

export const WIDTH = 320;
export const HEIGHT = 372;
const MIDDLE = WIDTH / 2;

const TRUNK: [string, number][] = [["head", 40], ["neck", 80], ["upper_chest", 103], ["chest", 125], ["spine", 148], ["hips", 176]];
const ASIDE: Record<(typeof LIMBS)[number], [number, number]> = {
  shoulder: [17, 93], upper_arm: [42, 99], lower_arm: [69, 149], hand: [95, 198],
  upper_leg: [19, 190], lower_leg: [24, 262], foot: [28, 334], toes: [35, 353],
};
// the hand is drawn larger than life, or its fifteen joints could not be hit
const FAN: Record<(typeof FINGERS)[number], { turn: number; at: [number, number, number] }> = {
  thumb: { turn: -76, at: [21, 35, 48] },
  index: { turn: -32, at: [32, 47, 61] },
  middle: { turn: -7, at: [33, 51, 67] },
  ring: { turn: 17, at: [32, 48, 63] },
  little: { turn: 41, at: [30, 44, 57] },
};

function figure(): Spot[] {
  const spots: Spot[] = TRUNK.map(([role, y]) => ({ role, x: MIDDLE, y, small: false }));
  spots.push({ role: "jaw", x: MIDDLE, y: 56, small: true });
  for (const side of SIDES) {
    const sign = side === "left" ? 1 : -1;
    spots.push({ role: `${side}_eye`, x: MIDDLE + 10 * sign, y: 31, small: true });
    for (const limb of LIMBS) spots.push({ role: `${side}_${limb}`, x: MIDDLE + sign * ASIDE[limb][0], y: ASIDE[limb][1], small: false });
    const [hx, hy] = ASIDE.hand, along = Math.atan2(hx - ASIDE.lower_arm[0], hy - ASIDE.lower_arm[1]);
    for (const finger of FINGERS) {
      const { turn, at } = FAN[finger], angle = along + (turn * Math.PI) / 180;
      (finger === "thumb" ? BONES.thumb : BONES.other).forEach((bone, n) =>
        spots.push({ role: `${side}_${finger}_${bone}`, x: MIDDLE + sign * (hx + at[n] * Math.sin(angle)), y: hy + at[n] * Math.cos(angle), small: true }),
      );
    }
  }
  return spots;
}

/** Where every role lies on the figure. */
export const SPOTS: readonly Spot[] = figure();
const PLACES = new Map(SPOTS.map((spot) => [spot.role, spot]));

export function spotOf(role: string): Spot {
  const spot = PLACES.get(role);
  if (!spot) throw new Error(`no role '${role}'`);
  return spot;
}

/** Roles of a humanoid, and joints of further chains such as tail:1. */
export const isRole = (name: string): boolean => PLACES.has(name) || /^[a-z_]+:\d+$/.test(name);

/** What most names begin with, up to a separator: "mixamorig:", "CC_Base_". */
export function commonPrefix(names: readonly string[]): string {
  const counts = new Map<string, number>();
  for (const name of names) for (const { index } of name.matchAll(/[:_|.]/g)) counts.set(name.slice(0, index + 1), (counts.get(name.slice(0, index + 1)) ?? 0) + 1);
  const shared = [...counts].filter(([prefix, count]) => prefix.length > 2 && count >= 0.7 * names.length).map(([prefix]) => prefix);
  return shared.reduce((longest, prefix) => (prefix.length > longest.length ? prefix : longest), "");
}

/** "left_index_proximal" as "Left index, proximal". */
export function labelOf(role: string): string {
  const words = role.split("_"), finger = FINGERS.findIndex((f) => words.includes(f));
  const text = finger < 0 ? words.join(" ") : `${words.slice(0, -1).join(" ")}, ${words.at(-1)!}`;
  return text[0].toUpperCase() + text.slice(1);
}

export function sideOf(role: string): Side {
  return role.startsWith("left_") ? "left" : role.startsWith("right_") ? "right" : "";
}

export function otherSide(role: string): string {
  const side = sideOf(role);
  return side === "" ? role : `${side === "left" ? "right" : "left"}_${role.slice(side.length + 1)}`;
}

/** How far a role is to be trusted: found by the server with its confidence, or set here. */
export function doubtOf(role: string, table: RoleTable, found: RetargetRoles): Doubt {
  const joint = table[role];
  if (joint === undefined) return found.missing.includes(role) || REQUIRED.has(role) ? "needed" : "none";
  if (found.roles[role] !== joint) return "set";
  const sure = found.confidence[role] ?? 0;
  return sure >= 0.9 ? "sure" : sure > 0.5 ? "likely" : "unsure";
}

/** What a humanoid has at least: keypose.analysis.roles.REQUIRED. */
export const REQUIRED: ReadonlySet<string> = new Set([
  "hips", "spine", "head",
  ...SIDES.flatMap((side) => ["upper_leg", "lower_leg", "foot", "upper_arm", "lower_arm", "hand"].map((part) => `${side}_${part}`)),
]);

export function missingOf(table: RoleTable): string[] {
  return [...REQUIRED].filter((role) => !(role in table));
}

// ---- changes: each gives a new table ---------------------------------------------------------------------------------

/** Give a role to a joint; who played it before and what the joint played before are free again. */
export function assigned(table: RoleTable, role: string, joint: string | null): RoleTable {
  const kept = Object.entries(table).filter(([r, j]) => r !== role && j !== joint);
  return inOrder(joint === null ? kept : [...kept, [role, joint]]);
}

/** All roles of one side as those of the other, by the joints' names, else by where they stand at rest. */
export function mirrored(table: RoleTable, from: "left" | "right", rig: Rig): RoleTable {
  const pairs = mirrorPairs(rig.names);
  const away = otherSide(`${from}_hand`).slice(0, -"_hand".length) as Side;
  const kept = Object.entries(table).filter(([role]) => sideOf(role) !== away);
  const used = new Set(kept.map(([, joint]) => joint));
  const place = placesAtRest(rig), plane = planeOf(table, rig, place);
  for (const [role, joint] of Object.entries(table)) {
    if (sideOf(role) !== from) continue;
    const named = pairs.get(joint);
    const other = named !== undefined && named !== joint ? named : nearest(rig, place, plane, joint);
    if (other === null || used.has(other)) continue;
    used.add(other);
    kept.push([otherSide(role), other]);
  }
  return inOrder(kept);
}

type Vec = [number, number, number];

function placesAtRest(rig: Rig): Vec[] {
  const world = new Float64Array(12 * rig.count);
  rig.solve(rig.rest, world);
  return rig.names.map((_, j) => [world[12 * j + 9], world[12 * j + 10], world[12 * j + 11]]);
}

/** The plane between left and right: a point and a unit normal, by the hips' sides where they are known. */
function planeOf(table: RoleTable, rig: Rig, place: Vec[]): { point: Vec; normal: Vec } {
  const at = (role: string): Vec | null => (role in table && rig.index(table[role]) >= 0 ? place[rig.index(table[role])] : null);
  const hips = at("hips") ?? [0, 0, 0];
  for (const part of ["upper_leg", "upper_arm", "shoulder"]) {
    const left = at(`left_${part}`), right = at(`right_${part}`);
    if (!left || !right) continue;
    const apart: Vec = [left[0] - right[0], left[1] - right[1], left[2] - right[2]], length = Math.hypot(...apart);
    if (length > 1e-9) return { point: [(left[0] + right[0]) / 2, (left[1] + right[1]) / 2, (left[2] + right[2]) / 2], normal: [apart[0] / length, apart[1] / length, apart[2] / length] };
  }
  return { point: hips, normal: [1, 0, 0] };
}

/** The joint that stands where another one's mirror image is, if one does. */
function nearest(rig: Rig, place: Vec[], { point, normal }: { point: Vec; normal: Vec }, joint: string): string | null {
  const own = rig.index(joint);
  if (own < 0) return null;
  const p = place[own], away = 2 * ((p[0] - point[0]) * normal[0] + (p[1] - point[1]) * normal[1] + (p[2] - point[2]) * normal[2]);
  const image: Vec = [p[0] - away * normal[0], p[1] - away * normal[1], p[2] - away * normal[2]];
  let best = -1, least = 0.2 * Math.abs(away) + 1e-9;
  place.forEach((q, other) => {
    const distance = Math.hypot(q[0] - image[0], q[1] - image[1], q[2] - image[2]);
    if (other !== own && distance < least) [best, least] = [other, distance];
  });
  return best < 0 ? null : rig.names[best];
}

function inOrder(entries: [string, string][]): RoleTable {
  const table = new Map(entries);
  const drawn = SPOTS.filter(({ role }) => table.has(role)).map(({ role }) => [role, table.get(role)!]);
  return Object.fromEntries([...drawn, ...entries.filter(([role]) => !PLACES.has(role))]);
}

// ---- files: those of `keypose roles FILE map.json` -------------------------------------------------------------------

export function toJson(table: RoleTable): string {
  return `${JSON.stringify(table, null, 1)}\n`;
}

/** A saved map; throws with the reason where it does not fit the skeleton. */
export function fromJson(text: string, joints: readonly string[]): RoleTable {
  let saved: unknown;
  try {
    saved = JSON.parse(text);
  } catch {
    throw new Error("It is no JSON.");
  }
  if (typeof saved !== "object" || saved === null || Array.isArray(saved)) throw new Error("It is no map of roles to joint names.");
  const known = new Set(joints), entries = Object.entries(saved);
  for (const [role, joint] of entries) {
    if (!isRole(role)) throw new Error(`There is no role “${role.slice(0, 60)}”.`);
    if (typeof joint !== "string" || !known.has(joint)) throw new Error(`The skeleton has no joint “${String(joint).slice(0, 60)}”.`);
  }
  return inOrder(entries as [string, string][]);
}
