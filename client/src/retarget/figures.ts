// The figures of a retargeted motion in the order in which people read them.

import type { RetargetDone } from "../generated/messages";
import type { Lane } from "../ui/timeline-drawing";
import type { Theme } from "../view/palette";
import { SIDES, type SideName } from "./pair";
import { SLIDING, STILL, type Print } from "./prints";

export interface Group {
  label: string;
  mean: number;
  bones: { label: string; degrees: number }[];
}

const GROUPS: [string, RegExp][] = [
  ["Arms", /arm$|shoulder$|hand$/],
  ["Legs", /leg$/],
  ["Feet", /foot$|toes$/],
  ["Trunk and head", /^(hips|spine|chest|upper_chest|neck|head)$/],
];

/** Angles between the bones of both bodies by part of the body, their mean first. */
export function directionGroups(directions: Readonly<Record<string, number>>): Group[] {
  const rest = new Set(Object.keys(directions));
  const groups: Group[] = [];
  for (const [label, pattern] of [...GROUPS, ["Fingers and others", /./] as const]) {
    const bones = [...rest].filter((bone) => pattern.test(bone));
    if (bones.length === 0) continue;
    for (const bone of bones) rest.delete(bone);
    groups.push({
      label,
      mean: bones.reduce((sum, bone) => sum + directions[bone], 0) / bones.length,
      bones: bones.map((bone) => ({ label: bone.replaceAll("_", " "), degrees: directions[bone] })),
    });
  }
  return groups;
}

/** Sliding of feet: the source's, the target's before planting (where feet were planted), and the target's. */
export function slides(done: RetargetDone, planted: boolean): { label: string; value: number; kind: "source" | "loose" | "target" }[] {
  return [
    { label: "Source", value: done.source_slide_cm_s, kind: "source" },
    ...(planted ? [{ label: "Before planting", value: done.loose_slide_cm_s, kind: "loose" as const }] : []),
    { label: "Target", value: done.slide_cm_s, kind: "target" },
  ];
}

const COLORS: Record<Theme, [[number, number, number], [number, number, number]]> = {
  dark: [[67, 192, 138], [255, 90, 79]],
  light: [[18, 133, 90], [211, 40, 29]],
};

/** From still to sliding. */
export function slideColor(slide: number, theme: Theme): string {
  const u = Math.max(0, Math.min(1, (slide - STILL) / (SLIDING - STILL))), [a, b] = COLORS[theme];
  return `rgb(${a.map((channel, n) => Math.round(channel + u * (b[n] - channel))).join(" ")})`;
}

/** A lane for each of the two, its left foot in the upper half and its right foot in the lower. */
export function contactLanes(prints: Readonly<Record<SideName, readonly Print[]>>, theme: Theme): Lane[] {
  if (prints.source.length + prints.target.length === 0) return [];
  return SIDES.map((side) => ({
    label: side === "source" ? "From" : "To",
    spans: prints[side].map((print) => [print.from, print.to, slideColor(print.slide, theme), print.side === "left" ? 1 : 2] as const),
  }));
}
