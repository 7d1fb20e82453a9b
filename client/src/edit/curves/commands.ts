// The commands of the curve views, for the palette, both key maps and the menus.

import { register, type Command } from "../commands";
import { Mode, Tangent } from "../contract";
import { EASES } from "../keys";
import * as act from "./actions";
import type { Drag } from "./drags";
import { heldKeys, MoveDrag, ScaleDrag } from "./drags";
import { selectionBox } from "./picking";
import { countKeys, masksOf } from "./selection";
import type { CurveSession, MenuItem } from "./session.svelte";

export const MODES: readonly [Mode, string][] = [
  [Mode.Step, "Step"],
  [Mode.Linear, "Linear"],
  [Mode.Bezier, "Bezier"],
  [Mode.Hermite, "Hermite"],
  [Mode.Squad, "Squad (rotations)"],
  [Mode.SphericalBezier, "Spherical Bezier (rotations)"],
  [Mode.LogCubic, "Cubic in log space (rotations)"],
];
export const TYPES: readonly [Tangent, string][] = [
  [Tangent.Auto, "Automatic"],
  [Tangent.Clamped, "Automatic, clamped"],
  [Tangent.Aligned, "Aligned"],
  [Tangent.Free, "Free"],
  [Tangent.Vector, "Vector"],
  [Tangent.Flat, "Flat"],
];
export const ENDS: readonly [string, string][] = [
  ["hold", "Hold"],
  ["linear", "Linear"],
  ["cycle", "Cycle"],
  ["cycle_offset", "Cycle with offset"],
  ["ping_pong", "Ping-pong"],
];

const any = (session: CurveSession) => countKeys(session.editor.selection) > 0;

/** Move selected keys with the pointer until a click. */
export function grab(session: CurveSession, duplicate = false): void {
  if (!any(session) || session.drag) return;
  const { x, y } = session.pointer;
  session.begin(new MoveDrag(session, x, y, anchorOf(session), { modal: true, values: session.mode === "graph" && !duplicate, duplicate }));
}

/** The active key, or the first that is selected: what snaps to frames. */
export function anchorOf(session: CurveSession): { time: number; value: number; factor: number } | null {
  const curves = session.curves(), held = heldKeys(session);
  const active = session.active && held.has(session.active.channel) ? session.active : null;
  const channel = active?.channel ?? held.keys().next().value;
  const own = channel === undefined ? undefined : held.get(channel), curve = channel === undefined ? undefined : curves.get(channel);
  if (!own || !curve) return null;
  const key = active && own.indices.includes(active.key) ? active.key : own.indices[0];
  const component = active?.component ?? Math.max(0, [0, 1, 2, 3].find((c) => ((masksOf(own.indices)?.[0] ?? 1) >> c) & 1) ?? 0);
  const shape = session.shapes(curves).find((s) => s.line.channel === channel && s.line.component === component);
  const factor = shape?.factor ?? 1;
  return { time: curve.times[key], value: factor * curve.values[key * curve.components + component] + (shape?.offset ?? 0), factor };
}

export function scale(session: CurveSession): void {
  if (!any(session) || session.drag) return;
  const { view } = session, { x, y } = session.pointer;
  const box = session.mode === "graph" ? selectionBox(view, session.shapes(), session.editor.selection) : null;
  const pivot = box ? { x: (box.x0 + box.x1) / 2, y: (box.y0 + box.y1) / 2 } : { x: view.toX(session.editor.time), y: view.height / 2 };
  session.begin(new ScaleDrag(session, x, y, pivot, { time: true, value: session.mode === "graph" }, true, "grabbing"));
}

export function lockAxis(drag: Drag, axis: "x" | "y"): void {
  drag.lock = drag.lock === axis ? null : axis;
}

/** Names of what the selected keys have, where they all have the same. */
function common<T>(session: CurveSession, of: (key: string, k: number) => T | null): T | null {
  let found: T | null = null;
  for (const [key, { indices }] of heldKeys(session))
    for (const k of indices) {
      const own = of(key, k);
      if (found === null) found = own;
      else if (own !== found) return null;
    }
  return found;
}

export function modeMenu(session: CurveSession): MenuItem[] {
  const curves = session.curves();
  const now = common(session, (key, k) => curves.get(key)!.modes[k]);
  const rotations = [...heldKeys(session).values()].some(({ curve }) => curve.kind === "rotation");
  const eases = Object.keys(EASES).map((name) => ({ label: name, run: () => act.changeEase(session, name) }));
  return [
    { label: "Interpolation", heading: true },
    ...MODES.filter(([mode]) => mode < Mode.Squad || rotations).map(([mode, label]) => ({ label, checked: now === mode, run: () => act.changeMode(session, mode) })),
    { label: "Ease to the next key", heading: true },
    ...eases,
  ];
}

export function typeMenu(session: CurveSession): MenuItem[] {
  const curves = session.curves();
  const now = common(session, (key, k) => curves.get(key)!.types?.[2 * k + 1] ?? Tangent.Free);
  return [
    { label: "Tangents", heading: true },
    ...TYPES.map(([type, label]) => ({ label, checked: now === type, run: () => act.changeType(session, type) })),
    { label: "Break: both sides free", run: () => act.changeType(session, Tangent.Free) },
  ];
}

export function endMenu(session: CurveSession): MenuItem[] {
  const held = [...heldKeys(session).values()].map((h) => h.curve);
  const curves = held.length > 0 ? held : session.shapes().map((s) => s.curve);
  const all = (side: "before" | "after", rule: string) => curves.length > 0 && curves.every((c) => c[side] === rule);
  return [
    { label: "Before the first key", heading: true },
    ...ENDS.map(([rule, label]) => ({ label, checked: all("before", rule), run: () => act.changeEnds(session, rule, null) })),
    { label: "After the last key", heading: true },
    ...ENDS.map(([rule, label]) => ({ label, checked: all("after", rule), run: () => act.changeEnds(session, null, rule) })),
  ];
}

function atPointer(session: CurveSession, items: readonly MenuItem[]): void {
  session.menu = { x: session.pointer.x, y: session.pointer.y, items };
}

export function contextMenu(session: CurveSession): MenuItem[] {
  const some = any(session);
  const item = (label: string, run: () => void, keys = "", enabled = some): MenuItem => ({ label, run, keys, disabled: !enabled });
  return [
    item("Move", () => grab(session), "G"),
    item("Scale", () => scale(session), "S"),
    item("Duplicate", () => grab(session, true), "Shift+D"),
    item("Delete", () => act.deleteSelected(session), "X"),
    { label: "", heading: true },
    item("Interpolation…", () => atPointer(session, modeMenu(session)), "T"),
    item("Tangents…", () => atPointer(session, typeMenu(session)), "V"),
    item("Extrapolation…", () => atPointer(session, endMenu(session)), "Shift+E", true),
    { label: "", heading: true },
    item("Copy", () => act.copySelected(session), "Ctrl+C"),
    item("Paste", () => act.paste(session), "Ctrl+V", act.hasClipboard()),
    item("Paste, going on from here", () => act.paste(session, { offset: true }), "", act.hasClipboard()),
    item("Paste mirrored in time", () => act.paste(session, { mirrored: true }), "Shift+Ctrl+V", act.hasClipboard()),
    { label: "", heading: true },
    item("Snap to frames", () => act.snapSelected(session), "Shift+S"),
    item("Mirror in time", () => act.mirrorTime(session, "middle"), "Ctrl+M"),
    item("Mirror values", () => act.mirrorValues(session)),
    item("Insert keys at the playhead", () => act.insertAtPlayhead(session), "I", true),
  ];
}

/** The table of the curve views; keys count while the pointer is over them. */
export function curveCommands(session: CurveSession): Command[] {
  const some = () => any(session);
  const command = (id: string, label: string, blender: string, run: () => void, when?: () => boolean, maya = blender): Command => ({
    id: `curves.${id}`, label, group: "Curves", blender, maya, area: "curves", run: () => run(), when,
  });
  return [
    command("grab", "Move the selected keys", "G", () => grab(session), some, "W"),
    command("scale", "Scale the selected keys", "S", () => scale(session), some, "R"),
    command("duplicate", "Duplicate the selected keys", "Shift+D", () => grab(session, true), some, "Ctrl+D"),
    command("delete", "Delete the selected keys", "X Delete", () => act.deleteSelected(session), some, "Delete Backspace"),
    command("insert", "Insert keys at the playhead on these curves", "I", () => act.insertAtPlayhead(session), undefined, "I"),
    command("copy", "Copy keys", "Ctrl+C", () => act.copySelected(session), some),
    command("paste", "Paste keys", "Ctrl+V", () => act.paste(session), act.hasClipboard),
    command("paste-offset", "Paste keys, going on from the curve", "Alt+V", () => act.paste(session, { offset: true }), act.hasClipboard),
    command("paste-mirrored", "Paste keys mirrored in time", "Ctrl+Shift+V", () => act.paste(session, { mirrored: true }), act.hasClipboard),
    command("interpolation", "Interpolation of the selected keys", "T", () => atPointer(session, modeMenu(session)), some),
    command("tangents", "Tangents of the selected keys", "V", () => atPointer(session, typeMenu(session)), some),
    command("extrapolation", "Extrapolation", "Shift+E", () => atPointer(session, endMenu(session))),
    command("snap", "Snap the selected keys to frames", "Shift+S", () => act.snapSelected(session), some),
    command("mirror", "Mirror the selected keys in time", "Ctrl+M", () => act.mirrorTime(session, "middle"), some),
    command("mirror-playhead", "Mirror the selected keys about the playhead", "", () => act.mirrorTime(session, "playhead"), some),
    command("mirror-values", "Mirror the values of the selected keys", "", () => act.mirrorValues(session), some),
    command("select-all", "Select all keys", "A", () => act.selectAll(session), undefined, "Ctrl+A"),
    command("select-none", "Select no keys", "Alt+A", () => act.selectNone(session), undefined, "Alt+A"),
    command("select-inverse", "Select the other keys", "Ctrl+I", () => act.selectInverse(session)),
    command("select-before", "Select keys before the playhead", "[", () => act.selectSide(session, false)),
    command("select-after", "Select keys after the playhead", "]", () => act.selectSide(session, true)),
    command("select-next", "Select the next keys", "Shift+ArrowRight", () => act.selectNeighbour(session, 1), some),
    command("select-previous", "Select the keys before", "Shift+ArrowLeft", () => act.selectNeighbour(session, -1), some),
    command("frame-all", "Frame all curves", "Home", () => session.frameAll(), undefined, "A"),
    command("frame-selected", "Frame the selected keys", "F", () => session.frameSelected(), undefined, "F"),
    command("normalise", "Normalised curves", "Alt+N", () => toggleNormalised(session)),
    command("ripple", "Ripple: later keys follow", "", () => (session.ripple = !session.ripple)),
    command("view", "Graph or dope sheet", "Ctrl+Tab Tab", () => toggleView(session), undefined, "Tab"),
    ...MODES.map(([mode, label]) => command(`mode-${Mode[mode].toLowerCase()}`, `Interpolation: ${label}`, "", () => act.changeMode(session, mode), some)),
    ...TYPES.map(([type, label]) => command(`tangent-${Tangent[type].toLowerCase()}`, `Tangents: ${label}`, "", () => act.changeType(session, type), some)),
    ...Object.keys(EASES).map((name) => command(`ease-${name.toLowerCase().replaceAll(" ", "-")}`, `Ease: ${name}`, "", () => act.changeEase(session, name), some)),
  ];
}

export function toggleNormalised(session: CurveSession): void {
  session.normalised = !session.normalised;
  session.frameAll();
}

export function toggleView(session: CurveSession): void {
  session.mode = session.mode === "graph" ? "dope" : "graph";
  session.schedule();
}

export const registerCurveCommands = (session: CurveSession) => register(...curveCommands(session));
