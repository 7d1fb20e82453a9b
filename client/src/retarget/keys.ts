// Keys of the retarget page.

import { transportShortcuts, type Shortcut } from "../shortcuts";
import { studio } from "../studio.svelte";
import type { View } from "../view/camera";
import { savePicture } from "./outputs";
import { retarget } from "./retarget.svelte";

export function retargetShortcuts(open: () => void): Shortcut[] {
  const look = (keys: string, does: string, run: () => void): Shortcut => ({ keys, does, group: "Look", run });
  const roles = (keys: string, does: string, run: () => void): Shortcut => ({ keys, does, group: "Retarget", run });
  const win = (keys: string, does: string, run: () => void): Shortcut => ({ keys, does, group: "Window", run });
  const view = (keys: string, name: View): Shortcut => look(keys, `View: ${name}`, () => retarget.stages?.frame(name));
  return [
    ...transportShortcuts(retarget),
    look("F", "Frame both", () => retarget.stages?.frame()),
    view("5", "front"),
    view("6", "side"),
    view("7", "top"),
    view("8", "three-quarter"),
    look("R", "Follow them", () => retarget.toggle3d("follow")),
    look("K", "One camera for both, or each its own", () => retarget.toggle3d("linked")),
    look("B", "Bones", () => retarget.toggle3d("bones")),
    look("Z", "Surface, edges or skeleton", () => retarget.nextSurface()),
    look("P", "Prints of the feet", () => retarget.toggle3d("prints")),
    look("D", "Floor grid", () => retarget.toggle3d("grid")),
    roles("Enter", "Retarget", () => void retarget.retarget()),
    roles("Q", "Roles of joints, or the fit", () => ((retarget.panel = true), (retarget.tab = retarget.tab === "roles" ? "fit" : "roles"))),
    roles("X", "Roles of the other character", () => retarget.pick(retarget.side === "source" ? "target" : "source")),
    roles("Delete", "The chosen role is played by none", () => retarget.role && retarget.assign(retarget.role, null)),
    roles("Escape", "No role is chosen", () => retarget.chooseRole(null)),
    win("M", "To the view page", () => studio.turnTo("view")),
    win("O", "Open files", open),
    win("V", "Save a picture", () => void savePicture()),
    win("T", "Dark or light theme", () => studio.setTheme(studio.theme === "dark" ? "light" : "dark")),
    win("2", "Panel", () => (retarget.panel = !retarget.panel)),
    win("Ctrl+Z", "Undo a change of roles", () => retarget.history.undo()),
    win("Ctrl+Shift+Z", "Redo", () => retarget.history.redo()),
    win("?", "This panel", () => (studio.help = !studio.help)),
  ];
}
