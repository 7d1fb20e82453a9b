// Keys of joints at the current time: the menu that inserts them, and removing them.

import type { Property } from "./contract";
import { editor } from "./editor.svelte";
import { layout } from "./layout.svelte";
import type { Entry } from "./Menu.svelte";
import { page } from "./page.svelte";
import { channelsFor } from "./posing";

/** Joints that a command without a selection means: all that have curves. */
function chosenJoints(): readonly number[] {
  const { actor, clip, selectedJoints } = editor;
  if (selectedJoints.length > 0 || !actor || !clip) return selectedJoints;
  const named = new Set([...clip.curves.values()].map((c) => c.channel.target));
  return actor.rig.names.flatMap((name, joint) => (named.has(name) ? [joint] : []));
}

export function insert(...properties: Property[]): void {
  editor.insertKeys(chosenJoints(), properties);
}

/** Key every channel that the chosen joints have already. */
export function insertAvailable(): void {
  const { actor, clip } = editor;
  if (!actor || !clip) return;
  const joints = chosenJoints(), names = new Set(joints.map((j) => actor.rig.names[j]));
  const properties = new Set<Property>();
  for (const { channel } of clip.curves.values()) if (names.has(channel.target)) properties.add(channel.property);
  const keyed = [...properties].filter((p) => p !== "weight" && p !== "value");
  const withAny = joints.filter((j) => keyed.some((p) => channelsFor(clip, actor.rig.names[j], p, layout.rotations).some((c) => clip.curves.has(c.key))));
  editor.insertKeys(withAny, keyed);
}

export function removeKeysNow(joints: readonly number[], properties: readonly Property[]): void {
  const { actor, clip } = editor;
  if (!actor || !clip) return;
  editor.removeKeys(joints.flatMap((j) => properties.flatMap((p) => channelsFor(clip, actor.rig.names[j], p, layout.rotations).map((c) => c.key))));
}

export function keyMenu(): void {
  const { actor, selectedJoints } = editor;
  if (!actor || !editor.clip) return;
  const entries: Entry[] = [
    { label: "Location", note: "Key where the selected joints are", run: () => insert("translation") },
    { label: "Rotation", note: "Key how the selected joints are turned", run: () => insert("rotation") },
    { label: "Scale", note: "Key how large the selected joints are", run: () => insert("scale") },
    { label: "Location and rotation", run: () => insert("translation", "rotation") },
    { label: "Location, rotation and scale", run: () => insert("translation", "rotation", "scale") },
    null,
    { label: "All that is keyed already", note: "Key every channel that has a curve", run: insertAvailable },
    { label: "All shapes", off: actor.morphNames.length === 0, run: () => editor.insertMorphKeys(actor.morphNames) },
  ];
  page.ask(selectedJoints.length > 0 ? "Insert keys" : "Insert keys for all joints with curves", entries);
}

