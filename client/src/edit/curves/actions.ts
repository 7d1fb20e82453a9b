// What can be done to selected keys at once: each makes one step of undo.

import { Mode, Tangent, type EditCurve, type KeySelection } from "../contract";
import {
  copyKeys,
  deleteKeys,
  EASES,
  insertKey,
  pasteKeys,
  retimeKeys,
  setEase,
  setExtrapolation,
  setMode,
  setType,
  STILL,
  transformKeys,
  type Clipboard,
  type Keyed,
  type PasteOptions,
} from "../keys";
import { heldKeys } from "./drags";
import { selectedTimes } from "./picking";
import { combined, everything, hit, masksOf, WHOLE, withMasks, type Hits } from "./selection";
import type { CurveSession } from "./session.svelte";

let clipboard: Clipboard | null = null;
export const hasClipboard = () => clipboard !== null;

/** One step of undo that puts curves in the place of those of the active clip. */
export function commit(session: CurveSession, label: string, changes: ReadonlyMap<string, EditCurve | null>, selection?: KeySelection): void {
  const { editor } = session;
  if (!editor.clip || changes.size === 0) return;
  editor.commit(label, { curves: new Map([[editor.clip.name, changes]]) });
  if (selection) editor.selection = selection;
  session.schedule();
}

/** An operation on the selected keys of every curve that can be edited. */
function each(session: CurveSession, label: string, make: (curve: EditCurve, indices: Uint32Array, mask: Uint8Array | null) => Keyed): void {
  const changes = new Map<string, EditCurve>(), selection = new Map(session.editor.selection);
  for (const [key, { curve, indices, mask }] of heldKeys(session)) {
    const done = make(curve, indices, mask);
    if (done.curve === curve) continue;
    changes.set(key, done.curve);
    selection.set(key, withMasks(done.indices, done.indices.length === indices.length ? mask : null));
  }
  commit(session, label, changes, selection);
}

export function deleteSelected(session: CurveSession): void {
  const changes = new Map<string, EditCurve | null>(), selection = new Map(session.editor.selection);
  for (const [key, { curve, indices }] of heldKeys(session)) {
    changes.set(key, deleteKeys(curve, indices));
    selection.delete(key);
  }
  session.active = null;
  commit(session, "Delete keys", changes, selection);
}

export const changeMode = (session: CurveSession, mode: Mode) =>
  each(session, "Set interpolation", (curve, indices) => ({ curve: setMode(curve, indices, mode), indices }));

export const changeType = (session: CurveSession, type: Tangent, side?: 0 | 1) =>
  each(session, "Set tangents", (curve, indices) => ({ curve: setType(curve, indices, type, side), indices }));

export const changeEase = (session: CurveSession, name: string) =>
  each(session, `Ease: ${name.toLowerCase()}`, (curve, indices) => {
    // of several keys in a row the spans between them, of a single one the span after it
    const inner = indices.filter((k, n) => indices[n + 1] === k + 1);
    return { curve: setEase(curve, inner.length > 0 ? inner : indices, EASES[name]), indices };
  });

/** Of the selected channels, or of all that are listed. */
export function changeEnds(session: CurveSession, before: string | null, after: string | null): void {
  const held = heldKeys(session), changes = new Map<string, EditCurve>();
  const curves = held.size > 0 ? [...held.values()].map((h) => h.curve) : session.shapes().map((s) => s.curve);
  for (const curve of curves) if (!session.editor.locked.has(curve.channel.key)) changes.set(curve.channel.key, setExtrapolation(curve, before, after));
  commit(session, "Set extrapolation", changes);
}

export const snapSelected = (session: CurveSession) =>
  each(session, "Snap to frames", (curve, indices) => {
    const { clip } = session.view, { rate } = session;
    return retimeKeys(curve, indices, (time) => {
      const frame = Math.round(((time - clip.shift) / clip.speed) * rate);
      return clip.speed * (frame / rate) + clip.shift;
    });
  });

/** Turned round in time about the playhead or about their own middle. */
export function mirrorTime(session: CurveSession, about: "middle" | "playhead"): void {
  const ends = selectedTimes(session.curves(), session.editor.selection);
  if (!ends) return;
  const pivot = about === "playhead" ? session.clipTime : (ends[0] + ends[1]) / 2;
  each(session, "Mirror times", (curve, indices, mask) => transformKeys(curve, indices, { ...STILL, scaleTime: -1, shiftTime: 2 * pivot }, mask));
}

export const mirrorValues = (session: CurveSession) =>
  each(session, "Mirror values", (curve, indices, mask) => transformKeys(curve, indices, { ...STILL, scaleValue: -1 }, mask));

/** Keys where the playhead is, on the selected channels or on all that are shown; the motion stays as it is. */
export function insertAtPlayhead(session: CurveSession): void {
  const { editor } = session;
  const chosen = [...editor.selection.keys()];
  const keys = chosen.length > 0 ? chosen : session.shapes().map((s) => s.line.channel);
  insertAt(session, new Set(keys), session.clipTime);
}

export function insertAt(session: CurveSession, channels: ReadonlySet<string>, time: number): void {
  const { editor } = session;
  const curves = session.curves(), changes = new Map<string, EditCurve>(), selection = new Map<string, Uint32Array>();
  for (const key of channels) {
    const curve = curves.get(key);
    if (!curve || editor.locked.has(key)) continue;
    const done = insertKey(curve, time);
    if (done.curve !== curve) changes.set(key, done.curve);
    selection.set(key, done.indices);
  }
  commit(session, "Insert keys", changes, selection);
}

// ---- copy and paste ------------------------------------------------------------------------------------------------------

export function copySelected(session: CurveSession): void {
  const copied = copyKeys([...heldKeys(session).values()]);
  if (copied) clipboard = copied;
}

/** At the playhead, into the channels that the keys came from or, of one channel, into those that are selected. */
export function paste(session: CurveSession, options: Partial<PasteOptions> = {}): void {
  const { editor } = session;
  if (!clipboard || !editor.clip) return;
  const curves = editor.clip.curves, changes = new Map<string, EditCurve>(), selection = new Map<string, Uint32Array>();
  const at = session.clipTime;
  const put = (source: EditCurve, target: EditCurve["channel"]) => {
    const there = curves.get(target.key) ?? null;
    if (editor.locked.has(target.key) || (there && (there.kind !== source.kind || there.components !== source.components))) return;
    const done = pasteKeys(there, source, clipboard!.length, target, { at, ...options });
    changes.set(target.key, done.curve);
    selection.set(target.key, done.indices);
  };
  const chosen = [...editor.selection.keys()];
  if (clipboard.curves.length === 1 && chosen.length > 0 && !chosen.includes(clipboard.curves[0].channel.key))
    for (const key of chosen) {
      const curve = curves.get(key);
      if (curve) put(clipboard.curves[0], curve.channel);
    }
  else for (const curve of clipboard.curves) put(curve, curve.channel);
  commit(session, options.mirrored ? "Paste mirrored" : "Paste keys", changes, selection);
}

// ---- selecting ---------------------------------------------------------------------------------------------------------

function editable(session: CurveSession): EditCurve[] {
  const { locked } = session.editor, curves = session.curves();
  const keys = session.mode === "graph" ? new Set(session.shapes(curves).map((s) => s.line.channel)) : new Set(session.rows[0]?.channels ?? []);
  return [...keys].flatMap((key) => (locked.has(key) ? [] : (curves.get(key) ?? [])));
}

export function selectAll(session: CurveSession): void {
  session.editor.selection = everything(editable(session));
  session.schedule();
}

export function selectNone(session: CurveSession): void {
  session.editor.selection = new Map();
  session.active = null;
  session.schedule();
}

export function selectInverse(session: CurveSession): void {
  const taken: Hits = new Map();
  for (const [key, indices] of session.editor.selection) for (const k of indices) hit(taken, key, k, WHOLE);
  session.editor.selection = combined(everything(editable(session)), taken, "remove");
  session.schedule();
}

/** All keys before or after the playhead. */
export function selectSide(session: CurveSession, after: boolean): void {
  const now = session.clipTime, hits: Hits = new Map();
  for (const curve of editable(session))
    curve.times.forEach((t, k) => (after ? t >= now - 1e-6 : t <= now + 1e-6) && hit(hits, curve.channel.key, k, WHOLE));
  session.editor.selection = combined(new Map(), hits, "set");
  session.schedule();
}

/** From one key of each selected channel to the next or the one before. */
export function selectNeighbour(session: CurveSession, step: number): void {
  const curves = session.curves(), next = new Map<string, Uint32Array>();
  for (const [key, indices] of session.editor.selection) {
    const last = (curves.get(key)?.times.length ?? 1) - 1;
    const moved = Uint32Array.from(new Set([...indices].map((k) => Math.max(0, Math.min(last, k + step))))).sort();
    const mask = masksOf(indices);
    next.set(key, withMasks(moved, mask && mask.every((m) => m === mask[0]) ? mask.slice(0, moved.length) : null));
  }
  session.editor.selection = next;
  if (session.active) {
    const last = (curves.get(session.active.channel)?.times.length ?? 1) - 1;
    session.active = { ...session.active, key: Math.max(0, Math.min(last, session.active.key + step)) };
  }
  session.schedule();
}
