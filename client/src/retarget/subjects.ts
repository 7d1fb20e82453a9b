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

export interface Options {
  /** Null goes by the lengths of the legs. */
  scale: number | null;
  plant: boolean;
  keepHands: boolean;
  sourceReference: "auto" | "rest" | "time";
  referenceTime: number;
  targetReference: "auto" | "rest";
  rate: number | null;
}

/** As the command line does it. */
export const PLAIN: Options = { scale: null, plant: true, keepHands: false, sourceReference: "auto", referenceTime: 0, targetReference: "auto", rate: null };

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
    source_reference: options.sourceReference,
    reference_s: options.referenceTime,
    target_reference: options.targetReference,
    scale: options.scale,
    plant: options.plant,
    keep_hands: options.keepHands,
    rate_hz: options.rate,
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

/** A name as a part of a file's name. */
export const stem = (name: string): string => name.replace(/\.[^.]*$/, "").replace(/[^\w.-]+/g, "_") || "motion";

/** Give back what a scene holds that is shown no more. */
export function discard(file: OpenFile): void {
  for (const actor of file.actors) actor.dispose();
  file.dispose();
}
