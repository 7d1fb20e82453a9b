// Which joint of an animation drives which joint of a skeleton: the rule of keypose.evaluate.match_report.

import type { Rig } from "./rig";

/** Own name -> name in the animation: exact first, then in other case, then without a namespace. */
export function matchNames(theirs: Iterable<string>, own: string[]): Map<string, string> {
  const animated = [...new Set(theirs)];
  const known = new Set(animated);
  const sources = new Map<string, string>();
  for (const name of own) if (known.has(name)) sources.set(name, name);
  for (const fold of [(n: string) => n.toLowerCase(), bare]) {
    const used = new Set(sources.values());
    const free = unique(animated.filter((n) => !used.has(n)), fold);
    const ours = unique(own.filter((n) => !sources.has(n)), fold);
    for (const [key, name] of ours) if (free.has(key)) sources.set(name, free.get(key)!);
  }
  return sources;
}

/** The same for a character with a rig: joints by similar names, controls by their own names alone (`keypose.rig.baking.bound`). */
export function matchRig(theirs: Iterable<string>, rig: Rig): Map<string, string> {
  const joints = rig.names.slice(0, rig.jointCount), controls = new Set(rig.names.slice(rig.jointCount));
  const animated = [...new Set(theirs)], sources = new Map<string, string>();
  for (const name of animated) if (controls.has(name)) sources.set(name, name);
  for (const [own, source] of matchNames(animated.filter((n) => !controls.has(n)), joints)) sources.set(own, source);
  return sources;
}

const bare = (name: string) => name.replaceAll("|", ":").split(":").at(-1)!.toLowerCase();

/** Folded name -> name, for those that fold to something of their own. */
function unique(names: string[], fold: (name: string) => string): Map<string, string> {
  const found = new Map<string, string[]>();
  for (const name of names) found.set(fold(name), [...(found.get(fold(name)) ?? []), name]);
  return new Map([...found].filter(([, group]) => group.length === 1).map(([key, group]) => [key, group[0]]));
}

/** Whether two skeletons that share names also share their bones at rest, in direction and (to a tenth) in length. */
export function sameRest(a: Rig, b: Rig): boolean {
  let agree = 0, count = 0;
  for (const [own, other] of matchNames(a.names, b.names)) {
    const i = 3 * b.index(own), j = 3 * a.index(other);
    const [x, y, z] = b.rest.translations.subarray(i, i + 3), [u, v, w] = a.rest.translations.subarray(j, j + 3);
    const ours = Math.hypot(x, y, z), theirs = Math.hypot(u, v, w), lengths = ours * theirs;
    if (b.parents[b.index(own)] < 0 || lengths < 1e-8) continue;
    count++;
    if ((x * u + y * v + z * w) / lengths > 0.95 && Math.abs(ours / theirs - 1) < 0.1) agree++;
  }
  return count > 0 && agree >= 0.8 * count;
}
