// Commands of rigs for the palette and the keyboard.

import type { Command } from "../commands";
import { editor } from "../editor.svelte";
import { activeModule, keyHeld, resetControls, selectAllControls, toggleControls, toggleSwitch, walk } from "./actions";
import { rigging } from "./rigging.svelte";

export function rigCommands(): Command[] {
  const command = (id: string, label: string, keys: string, run: Command["run"], when?: Command["when"]): Command => ({
    id: `rig.${id}`,
    label,
    group: "Rig",
    blender: keys,
    maya: keys,
    run,
    ...(when ? { when } : {}),
  });
  const rigged = () => rigging.active !== null;
  const name = () => rigging.active!.name;
  return [
    command("add", "Add a rig: controls for this character", "", () => void rigging.add(editor.character!.name), () => editor.actor !== null && !rigged()),
    command("fit", "Fit the rig to the motion", "", () => void rigging.fit(name()), rigged),
    command("bake", "Bake the rig to joints", "", () => void rigging.bake(name()), rigged),
    command("remove", "Remove the rig", "", () => void rigging.remove(name()), rigged),
    command("switch", "FK to IK or back, without a jump", "Shift+K", toggleSwitch, () => rigged() && activeModule() !== null),
    command("reset", "Controls back to rest", "Alt+Shift+R", resetControls, rigged),
    command("key", "Key what was changed by hand", "K", keyHeld, () => rigged() && editor.posed.size > 0),
    command("all", "Select all controls", "Alt+Shift+A", selectAllControls, rigged),
    command("up", "Select the control above", "Alt+ArrowUp", () => walk("up"), rigged),
    command("down", "Select the controls below", "Alt+ArrowDown", () => walk("down"), rigged),
    command("show", "Show controls", "Shift+C", toggleControls, rigged),
  ];
}
