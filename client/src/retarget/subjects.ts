// Who stands on the two stages of the retarget page, and what is asked for them.

import type { Rig } from "../anim/rig";
import type { RetargetRequest, RetargetRoles } from "../generated/messages";
import type { OpenFile } from "../scene";
import type { SideName } from "./pair";
import type { RoleTable } from "./roles";

/** A scene on one of the two stages. */
export interface Subject {
  /** As the server knows it: the id of an open scene, or "sample:walk". */
  readonly reference: string;
  readonly name: string;
  readonly file: OpenFile;
  readonly found: readonly RetargetRoles[];
  readonly character: number;
  readonly animation: number;
}

/** The pose in which a body is taken to stand: the best that is found, its rest pose, or a moment of a motion. */
export type Stand = { readonly kind: "auto" } | { readonly kind: "rest" } | Moment;

/** A moment of the body's own motion, or of another open file of the same rig. */
export interface Moment {
  readonly kind: "moment";
  /** Id of the scene; empty for the body's own. */
  readonly scene: string;
  readonly name: string;
  /** Null for that file's rest pose. */
  readonly time: number | null;
  readonly rate: number;
}

export type Place = readonly [number, number, number];

/** Something that hands hold on to: where it is in the source's world, and in the target's where that is not the same, scaled. */
export interface Prop {
  readonly source: Place;
  readonly target: Place | null;
}

export interface Options {
  /** Null goes by the lengths of the legs. */
  scale: number | null;
  plant: boolean;
  keepHands: boolean;
  stands: Readonly<Record<SideName, Stand>>;
  props: readonly Prop[];
  rate: number | null;
  /** Id of a scene with somebody else's result, which is set beside this one; empty for none. */
  against: string;
}

const AUTO: Stand = { kind: "auto" };

/** As the command line does it. */
export const PLAIN: Options = { scale: null, plant: true, keepHands: false, stands: { source: AUTO, target: AUTO }, props: [], rate: null, against: "" };

/** A stand as the server is asked for it. */
export function referenceOf(stand: Stand): string {
  if (stand.kind !== "moment") return stand.kind === "rest" ? "rest" : "";
  const moment = stand.time === null ? "rest" : String(stand.time);
  return stand.scene ? `${stand.scene}:${moment}` : moment;
}

/** What the server is asked for. */
export function requestOf(source: Subject, target: Subject, options: Readonly<Options>, maps: Readonly<Record<SideName, RoleTable | null>>): RetargetRequest {
  return {
    type: "retarget",
    source: source.reference,
    source_character: source.character,
    animation: source.animation,
    target: target.reference,
    target_character: target.character,
    source_roles: maps.source && { ...maps.source },
    target_roles: maps.target && { ...maps.target },
    source_reference: referenceOf(options.stands.source),
    target_reference: referenceOf(options.stands.target),
    scale: options.scale,
    plant: options.plant,
    keep_hands: options.keepHands,
    props: options.props.map(({ source: place, target: there }) => [...place, ...(there ?? [])]),
    rate_hz: options.rate,
    against: options.against,
  };
}

/** The character of a scene that is most like a person, of a source one that performs; and its animation. */
export function mostHuman(side: SideName, found: readonly RetargetRoles[], file: OpenFile): { character: number; animation: number } {
  const performs = (n: number) => (side === "source" ? file.animations[0].match(file.actors[n].rig, []) : 0);
  const worth = (n: number) => 100 * performs(n) - 10 * found[n].missing.length;
  const character = found.map((_, n) => n).reduce((best, n) => (worth(n) > worth(best) ? n : best), 0);
  const { rig, morphNames } = file.actors[character];
  return { character, animation: Math.max(0, file.animations.findIndex((a) => a.match(rig, morphNames) > 0.3)) };
}

/** Whether a body stands in its rest pose; some files keep one that is folded or upside down, which shows nothing. */
export function standsAtRest(rig: Rig | null, table: RoleTable, found: RetargetRoles | null): boolean {
  if (!rig || found?.all_fours) return true;
  const world = new Float64Array(12 * rig.count);
  rig.solve(rig.rest, world);
  return [["hips", "head"], ["left_foot", "left_upper_leg"], ["right_foot", "right_upper_leg"]].every(([low, high]) => {
    if (table[low] === undefined || table[high] === undefined) return true;
    const [from, to] = [table[low], table[high]].map((name) => 12 * rig.index(name) + 9);
    const [x, y, z] = [0, 1, 2].map((axis) => world[to + axis] - world[from + axis]);
    return y > 0.6 * Math.hypot(x, y, z);
  });
}

/** Whether two skeletons are of one rig: half of the joints have the same names, as keypose.retarget.pose_of_other tells it. */
export function sameRig(a: Rig, b: Rig): boolean {
  const plain = (name: string) => name.slice(name.lastIndexOf(":") + 1).toLowerCase();
  const known = new Set(a.names.map(plain));
  return 2 * b.names.filter((name) => known.has(plain(name))).length >= b.names.length;
}

/** A name as a part of a file's name. */
export const stem = (name: string): string => name.replace(/\.[^.]*$/, "").replace(/[^\w.-]+/g, "_") || "motion";

/** Give back what a scene holds that is shown no more. */
export function discard(file: OpenFile): void {
  for (const actor of file.actors) actor.dispose();
  file.dispose();
}
