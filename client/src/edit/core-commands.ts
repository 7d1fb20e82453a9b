// The editor's own commands; the curves and the 3D view add theirs.

import { studio } from "../studio.svelte";
import type { Command } from "./commands";
import { freeName } from "./document";
import { editor } from "./editor.svelte";
import { insert, insertAvailable, keyMenu, removeKeysNow } from "./keying";
import { addLayer, addMarker, maskFromSelection, setRange } from "./layers";
import { layout } from "./layout.svelte";
import { page } from "./page.svelte";
import { project } from "./project.svelte";
import { selectFrom, selectTo } from "./span";

const some = () => editor.timeline !== null;
const joints = () => editor.selectedJoints.length > 0;

function seekMarker(direction: number): void {
  const times = editor.timeline?.markers.map((m) => m.time) ?? [];
  const next = direction > 0 ? times.find((t) => t > editor.time + 1e-6) : times.findLast((t) => t < editor.time - 1e-6);
  if (next !== undefined) editor.seek(next);
}

export function coreCommands(): Command[] {
  const command = (group: string) => (id: string, label: string, keys: string | [string, string], run: Command["run"], more: Partial<Command> = {}): Command => {
    const [blender, maya] = typeof keys === "string" ? [keys, keys] : keys;
    return { id, label, group, blender, maya, run, ...more };
  };
  const file = command("Project"), edit = command("Edit"), key = command("Keys"), time = command("Time");
  const select = command("Select"), layer = command("Layers"), show = command("Window");
  return [
    file("project.new", "New project…", "Ctrl+Alt+N", () => (project.dialog = "new")),
    file("project.open", "Open project…", "Ctrl+O", () => (project.dialog = "open")),
    file("project.save", "Save", "Ctrl+S", () => void project.save()),
    file("project.save-as", "Save as…", "Ctrl+Shift+S", () => (project.dialog = "save")),
    file("project.recover", "Recover unsaved work…", "", () => (project.dialog = "recover"), { when: () => project.recoverable.length > 0 }),
    file("project.export", "Export…", "Ctrl+E", () => (project.dialog = "export"), { when: some }),
    file("project.import", "Import an animation…", "", () => (project.dialog = "clip")),
    file("project.character", "Add a character…", "Shift+A", () => (project.dialog = "character"), { area: "viewport" }),

    edit("edit.undo", "Undo", ["Ctrl+Z", "Ctrl+Z Z"], () => editor.undo()),
    edit("edit.redo", "Redo", ["Ctrl+Shift+Z Ctrl+Y", "Ctrl+Shift+Z Ctrl+Y Shift+Z"], () => editor.redo()),
    edit("edit.palette", "Find any command", "F3 Ctrl+K", () => (page.palette = true)),

    key("key.menu", "Insert keys…", ["I", ""], keyMenu, { when: some }),
    key("key.all", "Key location, rotation and scale", ["", "S"], () => insert("translation", "rotation", "scale"), { when: some }),
    key("key.location", "Key location", ["", "Shift+W"], () => insert("translation"), { when: some }),
    key("key.rotation", "Key rotation", ["", "Shift+E"], () => insert("rotation"), { when: some }),
    key("key.scale", "Key scale", ["", "Shift+R"], () => insert("scale"), { when: some }),
    key("key.available", "Key all that is keyed already", "", insertAvailable, { when: some }),
    key("key.remove", "Remove the keys of the selected joints here", ["Alt+I", ""], () => removeKeysNow(editor.selectedJoints, ["translation", "rotation", "scale"]), { when: joints }),
    key("key.auto", "Auto-key on or off", "", () => (editor.autoKey = !editor.autoKey)),
    key("key.snap", "Snap keys to frames on or off", "Shift+Tab", () => (editor.snap = !editor.snap)),
    key("key.rotations", "Key new rotations as angles or as quaternions", "", () => {
      layout.rotations = layout.rotations === "euler" ? "rotation" : "euler";
      layout.remember();
      editor.toast("info", layout.rotations === "euler" ? "Angles" : "Quaternions", `Rotations that have no curve yet are keyed as ${layout.rotations === "euler" ? "three angles with handles" : "quaternions"}.`);
    }),

    time("time.play", "Play or pause", ["Space", "Alt+V Space"], () => editor.toggle(), { when: some }),
    time("time.back", "One frame back", ["ArrowLeft", "Alt+, ArrowLeft"], () => editor.stepFrames(-1), { when: some }),
    time("time.forward", "One frame on", ["ArrowRight", "Alt+. ArrowRight"], () => editor.stepFrames(1), { when: some }),
    time("time.key-back", "Previous key", ["ArrowDown", ", ArrowDown"], () => editor.seekKey(-1), { when: some }),
    time("time.key-forward", "Next key", ["ArrowUp", ". ArrowUp"], () => editor.seekKey(1), { when: some }),
    time("time.start", "To the start", ["Shift+ArrowLeft", "Alt+Shift+V Shift+ArrowLeft"], () => editor.seek(editor.timeline!.start), { when: some }),
    time("time.end", "To the end", "Shift+ArrowRight", () => editor.seek(editor.timeline!.end), { when: some }),
    time("time.loop", "Loop, once, ping-pong", "", () => editor.cycleMode()),
    time("time.range-start", "Range starts here", ["Ctrl+Home", "Alt+Home"], () => setRange(Math.min(editor.time, editor.timeline!.end), editor.timeline!.end), { when: some }),
    time("time.range-end", "Range ends here", ["Ctrl+End", "Alt+End"], () => setRange(editor.timeline!.start, Math.max(editor.time, editor.timeline!.start)), { when: some }),
    time("time.span-from", "Select the time from here on", ["Alt+Home", "Ctrl+Home"], () => selectFrom(editor, editor.time), { when: some }),
    time("time.span-to", "Select the time up to here", ["Alt+End", "Ctrl+End"], () => selectTo(editor, editor.time), { when: some }),
    time("time.span-none", "Select no time", "", () => (editor.span = null), { when: () => editor.span !== null }),
    time("time.marker", "Mark this moment", "M", () => addMarker(freeName("Marker", editor.timeline!.markers.map((m) => m.name)), editor.time), { when: some }),
    time("time.marker-back", "Previous marker", "", () => seekMarker(-1), { when: some }),
    time("time.marker-forward", "Next marker", "", () => seekMarker(1), { when: some }),

    select("select.find", "Find a joint", "/", () => {
      layout.open("left");
      setTimeout(() => document.querySelector<HTMLInputElement>("[data-testid=edit-find]")?.focus());
    }),

    layer("layer.add", "Add a layer", "", () => addLayer("replace"), { when: some }),
    layer("layer.add-additive", "Add an additive layer", "", () => addLayer("add"), { when: some }),
    layer("layer.mask", "Layer moves the selected joints alone", "", maskFromSelection, { when: () => some() && joints() }),

    show("show.joint", "Values of the joint", "", () => showTab("joint")),
    show("show.rig", "Rig", "", () => showTab("rig")),
    show("show.operators", "Operators", "", () => showTab("operators")),
    show("show.poses", "Poses", "", () => showTab("poses")),
    show("show.clip", "Timeline, layer and clip", "", () => showTab("clip")),
    show("show.left", "Characters and layers on or off", ["T", "Ctrl+["], () => layout.toggle("left")),
    show("show.right", "Inspector on or off", ["N", "Ctrl+]"], () => layout.toggle("right")),
    show("show.theme", "Dark or light theme", "", () => studio.setTheme(studio.theme === "dark" ? "light" : "dark")),
    show("show.stats", "Statistics of drawing", "", () => (studio.stats = !studio.stats)),
    show("show.keys-blender", "Keys as in Blender", "", () => setKeyMap("blender"), { when: () => layout.keyMap !== "blender" }),
    show("show.keys-maya", "Keys as in Maya", "", () => setKeyMap("maya"), { when: () => layout.keyMap !== "maya" }),
    show("show.view", "To the View page", "", () => studio.turnTo("view")),
    show("show.help", "Keyboard shortcuts", "?", () => (studio.help = !studio.help)),
  ];
}

function showTab(tab: typeof layout.tab): void {
  layout.tab = tab;
  layout.open("right");
}

export function setKeyMap(map: typeof layout.keyMap): void {
  layout.keyMap = map;
  layout.remember();
}
