// What can be done to controls, from the panel, the palette and by keys.

import type { RigModule } from "../../generated/messages";
import { channelOf, type ChannelId, type Property } from "../contract";
import { editor } from "../editor.svelte";
import { tools } from "../viewport/tools.svelte";
import { rigging } from "./rigging.svelte";
import { NO_WISH } from "./solver";

/** Go over to FK (0) or IK (1); the side that takes over is put where the limb is, so that nothing jumps. */
export function matchedSwitch(modules: readonly RigModule[], to: 0 | 1): Promise<void> {
  const wish = to === 1 ? "match_ik_to_fk" : "match_fk_to_ik", names = modules.map((m) => m.name);
  return rigging.wish(`${names.join(", ")} to ${to === 1 ? "IK" : "FK"}`, { ...NO_WISH, wish, modules: names }, new Map(modules.map((m) => [m.switch, to])));
}

export function selectControl(name: string, more: boolean): void {
  const joint = editor.actor?.rig.index(name) ?? -1;
  if (joint >= 0) editor.pick(joint, more);
}

/** The selected controls, or all where none is, back to rest. */
export function resetControls(): void {
  const { actor } = editor, data = rigging.active;
  if (!actor || !data) return;
  const { rig } = actor;
  const chosen = editor.selectedJoints.filter((j) => j >= rig.jointCount);
  const joints = chosen.length > 0 ? chosen : data.controls.map((_, n) => rig.jointCount + n);
  const values = new Map<string, readonly number[]>();
  for (const joint of joints) {
    const name = rig.names[joint], control = data.controls[joint - rig.jointCount];
    if (control.moves.includes("translation")) values.set(channelOf(name, "translation").key, [...rig.rest.translations.subarray(3 * joint, 3 * joint + 3)]);
    if (control.moves.includes("rotation")) values.set(channelOf(name, "rotation").key, [...rig.rest.rotations.subarray(4 * joint, 4 * joint + 4)]);
    if (control.moves.includes("scale")) values.set(channelOf(name, "scale").key, [...rig.rest.scales.subarray(3 * joint, 3 * joint + 3)]);
  }
  editor.pose(values, chosen.length === 1 ? `Reset ${rig.names[chosen[0]]}` : "Reset controls", true);
}

export function selectAllControls(): void {
  const rig = editor.actor?.rig;
  if (rig) editor.selectedJoints = Array.from({ length: rig.count - rig.jointCount }, (_, n) => rig.jointCount + n);
}

/** The controls and joints of a module. */
export const partsOf = (module: RigModule): readonly string[] => [...module.ik, ...module.fk, ...module.joints];

/** The module of the active control or joint. */
export function activeModule(): RigModule | null {
  const name = editor.actor?.rig.names[editor.selectedJoints.at(-1) ?? -1] ?? "";
  return rigging.active?.modules.find((m) => partsOf(m).includes(name)) ?? null;
}

/** FK where the active limb is IK and the other way round; all limbs that are selected go with it. */
export function toggleSwitch(): void {
  const active = activeModule(), { actor } = editor;
  if (!active?.switch || !actor) {
    editor.toast("info", "No limb is selected", "Pick a control of an arm, a leg or the spine first.");
    return;
  }
  const names = new Set(editor.selectedJoints.map((j) => actor.rig.names[j]));
  const chosen = rigging.active!.modules.filter((m) => m === active || (m.switch && partsOf(m).some((part) => names.has(part))));
  const now = actor.rig.pose.morphs[actor.rig.attributeIndex(active.switch)];
  void matchedSwitch(chosen, now > 0.5 ? 0 : 1);
}

/** Select the controls that hang on the active one, or the one that it hangs on. */
export function walk(way: "up" | "down"): void {
  const { actor } = editor, data = rigging.active, active = editor.selectedJoints.at(-1) ?? -1;
  if (!actor || !data || active < actor.rig.jointCount) return;
  const own = active - actor.rig.jointCount;
  const found = way === "up" ? [data.controls[own].parent].filter((n) => n >= 0) : data.controls.flatMap((c, n) => (c.parent === own ? [n] : []));
  if (found.length > 0) editor.selectedJoints = found.map((n) => actor.rig.jointCount + n);
}

/** Key exactly what is posed and not keyed, wherever the pointer is. */
export function keyHeld(): void {
  const { actor } = editor;
  if (!actor) return;
  const properties = new Map<number, Property[]>(), numbers: ChannelId[] = [];
  for (const key of editor.posed.keys()) {
    const [target, property] = key.split("\u0000") as [string, Property];
    const joint = actor.rig.index(target);
    if (property === "weight" || property === "value") numbers.push(channelOf(target, property));
    else if (joint >= 0) properties.set(joint, [...(properties.get(joint) ?? []), property]);
  }
  const all = new Set([...properties.values()].flat());
  editor.insertKeys([...properties.keys()], [...all], numbers);
}

export const toggleControls = (): void => {
  tools.controls = !tools.controls;
  tools.remember();
};
