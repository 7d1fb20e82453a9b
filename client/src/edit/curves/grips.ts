// The box around the selection, and scaling by its grips.

import { ScaleDrag, type Drag } from "./drags";
import { selectedTimes, selectionBox } from "./picking";
import { countKeys } from "./selection";
import type { CurveSession } from "./session.svelte";
import type { Shape } from "./shapes";
import type { Box } from "./view";

const PAD = 9;

/** Around the selected keys; in the dope sheet around their times, on the row of all channels. */
export function transformBox(session: CurveSession, shapes: readonly Shape[]): Box | null {
  if (countKeys(session.selection) < 2) return null;
  const { view } = session;
  if (session.mode === "dope") {
    const ends = selectedTimes(session.curves(), session.selection);
    if (!ends) return null;
    const x0 = view.clipX(ends[0]), x1 = view.clipX(ends[1]);
    return x1 - x0 < 14 ? null : { x0: x0 - PAD, y0: view.top + 3, x1: x1 + PAD, y1: view.top + 18 };
  }
  const box = selectionBox(view, shapes, session.selection);
  if (!box || box.x1 - box.x0 + box.y1 - box.y0 < 14) return null;
  return { x0: box.x0 - PAD, y0: box.y0 - PAD, x1: box.x1 + PAD, y1: box.y1 + PAD };
}

export function gripsOf({ mode }: CurveSession, { x0, y0, x1, y1 }: Box): [number, number][] {
  const xm = (x0 + x1) / 2, ym = (y0 + y1) / 2;
  if (mode === "dope") return [[x1, ym], [x0, ym]];
  return [[x0, y0], [xm, y0], [x1, y0], [x1, ym], [x1, y1], [xm, y1], [x0, y1], [x0, ym]];
}

/** Scaling begins where a grip is under the pointer. */
export function gripUnder(session: CurveSession, shapes: readonly Shape[], x: number, y: number): Drag | null {
  const graph = session.mode === "graph", box = transformBox(session, shapes);
  if (!box) return null;
  const inner = { x0: box.x0 + PAD, x1: box.x1 - PAD, y0: graph ? box.y0 + PAD : 0, y1: graph ? box.y1 - PAD : 0 };
  const all = gripsOf(session, box);
  const at = all.findIndex(([gx, gy]) => Math.abs(gx - x) < 6 && Math.abs(gy - y) < (graph ? 6 : 9));
  if (at < 0) return null;
  const [gx, gy] = all[at], left = gx === box.x0, right = gx === box.x1, top = graph && gy === box.y0, bottom = graph && gy === box.y1;
  const pivot = { x: left ? inner.x1 : inner.x0, y: top ? inner.y1 : inner.y0 };
  const cursor = left || right ? (top || bottom ? (left === top ? "nwse-resize" : "nesw-resize") : "ew-resize") : "ns-resize";
  const middle = { x: (inner.x0 + inner.x1) / 2, y: (inner.y0 + inner.y1) / 2 };
  // from the edge of the keys rather than from the grip, which stands a little outside
  const fromX = left ? inner.x0 : inner.x1, fromY = top ? inner.y0 : inner.y1;
  const drag = new ScaleDrag(session, fromX, fromY, pivot, { time: left || right, value: top || bottom }, false, cursor, middle);
  return shifted(drag, fromX - x, fromY - y);
}

/** A drag whose pointer is somewhere beside the mouse. */
function shifted(drag: Drag, dx: number, dy: number): Drag {
  const { move } = drag;
  drag.move = (x, y, modifiers) => move.call(drag, x + dx, y + dy, modifiers);
  return drag;
}
