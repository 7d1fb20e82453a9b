// What can be done to controls, from the panel, the palette and by keys.

import type { RigModule } from "../../generated/messages";
import { channelOf } from "../contract";
import { editor } from "../editor.svelte";
import { tools } from "../viewport/tools.svelte";
import { rigging } from "./rigging.svelte";
import { NO_WISH } from "./solver";

/** Go over to FK (0) or IK (1); the side that takes over is put where the limb is, so that nothing jumps. */
export function matchedSwitch(module: RigModule, to: 0 | 1): Promise<void> {
  const wish = to === 1 ? "match_ik_to_fk" : "match_fk_to_ik";
  return rigging.wish(`${module.name} to ${to === 1 ? "IK" : "FK"}`, { ...NO_WISH, wish, modules: [module.name] }, new Map([[module.switch, to]]));
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

/** The module of the active control or joint. */
export function activeModule(): RigModule | null {
  const name = editor.actor?.rig.names[editor.selectedJoints.at(-1) ?? -1] ?? "";
  return rigging.active?.modules.find((m) => m.fk.includes(name) || m.ik.includes(name) || m.joints.includes(name)) ?? null;
}

/** FK where it is IK and the other way round. */
export function toggleSwitch(): void {
  const module = activeModule(), { actor } = editor;
  if (!module?.switch || !actor) {
    editor.toast("info", "No limb is selected", "Pick a control of an arm, a leg or the spine first.");
    return;
  }
  const now = actor.rig.pose.morphs[actor.rig.attributeIndex(module.switch)];
  void matchedSwitch(module, now > 0.5 ? 0 : 1);
}

export const toggleControls = (): void => {
  tools.controls = !tools.controls;
  tools.remember();
};
