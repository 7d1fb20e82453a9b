// What is under the pointer, and what a box holds. Keys are found by their times, so thousands of them cost nothing.

import { keyFrom } from "../../anim/curve";
import type { EditCurve, KeySelection } from "../contract";
import { ROW, rowAt, rowTop, visibleRows, type DopeScene } from "./dope-drawing";
import { HANDLES, LEAST_REACH } from "./graph-drawing";
import { hit, isSelected, masksOf, WHOLE, type Hits } from "./selection";
import { handleOf, lineValue, shownValue, valueOf, type Shape } from "./shapes";
import type { Box, View } from "./view";

export interface KeyHit {
  readonly shape: Shape;
  readonly key: number;
}

export interface HandleHit extends KeyHit {
  readonly side: 0 | 1;
}

const NEAR = 7;

/** Keys of a curve between two places on the canvas: first, and one after the last. */
function keysBetween(curve: EditCurve, view: View, x0: number, x1: number): [number, number] {
  const a = view.clipTime(x0), b = view.clipTime(x1);
  const from = keyFrom(curve.times, Math.min(a, b));
  let to = keyFrom(curve.times, Math.max(a, b));
  while (to < curve.times.length && curve.times[to] <= Math.max(a, b)) to++;
  return [from, to];
}

/** The nearest key within reach; of keys at one place those of selected lines come first. */
export function keyUnder(view: View, shapes: readonly Shape[], selection: KeySelection, locked: ReadonlySet<string>, x: number, y: number): KeyHit | null {
  let best: KeyHit | null = null, least = NEAR;
  for (const shape of shapes) {
    const { curve, line } = shape;
    if (locked.has(line.channel)) continue;
    const [from, to] = keysBetween(curve, view, x - NEAR, x + NEAR);
    for (let k = from; k < to; k++) {
      const dx = view.clipX(curve.times[k]) - x;
      const dy = view.toY(shownValue(shape, curve.values[k * curve.components + line.component])) - y;
      const distance = Math.hypot(dx, dy) - (isSelected(selection, line.channel, k, line.component) ? 1.5 : 0);
      if (distance < least) {
        least = distance;
        best = { shape, key: k };
      }
    }
  }
  return best;
}

/** The nearest handle of a selected key, where handles are drawn. */
export function handleUnder(view: View, shapes: readonly Shape[], selection: KeySelection, locked: ReadonlySet<string>, x: number, y: number): HandleHit | null {
  let best: HandleHit | null = null, least = NEAR, seen = 0;
  for (const shape of shapes) {
    const { curve, line } = shape;
    const indices = selection.get(line.channel);
    if (!indices || locked.has(line.channel)) continue;
    const mask = masksOf(indices);
    for (let n = 0; n < indices.length; n++) {
      if (mask && !((mask[n] >> line.component) & 1)) continue;
      const k = indices[n];
      if (k >= curve.times.length) continue;
      const kx = view.clipX(curve.times[k]);
      if (kx < -80 || kx > view.width + 80) continue;
      if (++seen > HANDLES) return null;
      const value = curve.values[k * curve.components + line.component];
      for (const side of [0, 1] as const) {
        const reach = handleOf(shape, k, side);
        if (!reach) continue;
        const hx = view.clipX(curve.times[k] + reach[0]), hy = view.toY(shownValue(shape, value + reach[1]));
        if (Math.hypot(hx - kx, hy - view.toY(shownValue(shape, value))) < LEAST_REACH) continue;
        const distance = Math.hypot(hx - x, hy - y);
        if (distance < least) {
          least = distance;
          best = { shape, key: k, side };
        }
      }
    }
  }
  return best;
}

/** The line that passes the pointer. */
export function lineUnder(view: View, shapes: readonly Shape[], x: number, y: number): Shape | null {
  let best: Shape | null = null, least = 6;
  for (const shape of shapes) {
    const at = (px: number) => view.toY(shownValue(shape, lineValue(shape, view.clipTime(px))));
    const y0 = at(x - 2), y1 = at(x + 2);
    // steep lines pass beside the pointer, flat ones above or below it
    const distance = y >= Math.min(y0, y1) && y <= Math.max(y0, y1) ? 0 : Math.min(Math.abs(y - y0), Math.abs(y - y1));
    if (distance < least) {
      least = distance;
      best = shape;
    }
  }
  return best;
}

/** Everything of the graph inside a box. */
export function keysInBox(view: View, shapes: readonly Shape[], locked: ReadonlySet<string>, box: Box): Hits {
  const hits: Hits = new Map();
  for (const shape of shapes) {
    const { curve, line } = shape;
    if (locked.has(line.channel)) continue;
    const a = valueOf(shape, view.toValue(box.y0)), b = valueOf(shape, view.toValue(box.y1));
    const low = Math.min(a, b), high = Math.max(a, b);
    const [from, to] = keysBetween(curve, view, box.x0, box.x1);
    for (let k = from; k < to; k++) {
      const value = curve.values[k * curve.components + line.component];
      if (value >= low && value <= high) hit(hits, line.channel, k, 1 << line.component);
    }
  }
  return hits;
}

/** Keys of a row of the dope sheet within reach of a place. */
export function rowKeysUnder(scene: DopeScene, x: number, y: number): { hits: Hits; row: number; key: number } | null {
  const { view, rows, scroll, curves, locked } = scene;
  const r = rowAt(view, scroll, y), row = rows[r];
  if (!row) return null;
  let least = NEAR, time = NaN;
  let nearest = 0;
  for (const key of row.channels) {
    const curve = curves.get(key);
    if (!curve || locked.has(key)) continue;
    const [from, to] = keysBetween(curve, view, x - NEAR, x + NEAR);
    for (let k = from; k < to; k++) {
      const distance = Math.abs(view.clipX(curve.times[k]) - x);
      if (distance < least) {
        least = distance;
        time = curve.times[k];
        nearest = k;
      }
    }
  }
  if (time !== time) return null;
  const hits: Hits = new Map();
  const mask = row.kind === "component" ? 1 << row.component : WHOLE;
  for (const key of row.channels) {
    const curve = curves.get(key);
    if (!curve || locked.has(key)) continue;
    const k = keyFrom(curve.times, time - 2e-5);
    if (k < curve.times.length && Math.abs(curve.times[k] - time) <= 2e-5) hit(hits, key, k, mask);
  }
  return { hits, row: r, key: nearest };
}

/** Everything of the dope sheet inside a box. */
export function rowKeysInBox(scene: DopeScene, box: Box): Hits {
  const { view, rows, scroll, curves, locked } = scene;
  const hits: Hits = new Map();
  const [first, end] = visibleRows(scene);
  for (let r = first; r < end; r++) {
    const y = rowTop(view, scroll, r);
    if (y + ROW / 2 < box.y0 || y + ROW / 2 > box.y1) continue;
    const row = rows[r], mask = row.kind === "component" ? 1 << row.component : WHOLE;
    for (const key of row.channels) {
      const curve = curves.get(key);
      if (!curve || locked.has(key)) continue;
      const [from, to] = keysBetween(curve, view, box.x0, box.x1);
      for (let k = from; k < to; k++) hit(hits, key, k, mask);
    }
  }
  return hits;
}

/** The box around the selected keys on the canvas; null where fewer than two are there to see. */
export function selectionBox(view: View, shapes: readonly Shape[], selection: KeySelection): Box | null {
  let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity, count = 0;
  for (const shape of shapes) {
    const { curve, line } = shape;
    const indices = selection.get(line.channel);
    if (!indices) continue;
    const mask = masksOf(indices);
    const kx = view.keyScale, ox = view.keyOffset, ky = shape.factor * view.perUnit, oy = view.toY(shape.offset);
    for (let n = 0; n < indices.length; n++) {
      const k = indices[n];
      if (k >= curve.times.length || (mask && !((mask[n] >> line.component) & 1))) continue;
      const x = kx * curve.times[k] + ox, y = oy - ky * curve.values[k * curve.components + line.component];
      if (x < x0) x0 = x;
      if (x > x1) x1 = x;
      if (y < y0) y0 = y;
      if (y > y1) y1 = y;
      count++;
    }
  }
  return count > 1 ? { x0, y0, x1, y1 } : null;
}

/** First and last selected time of the clip. */
export function selectedTimes(curves: ReadonlyMap<string, EditCurve>, selection: KeySelection): [number, number] | null {
  let from = Infinity, to = -Infinity;
  for (const [key, indices] of selection) {
    const curve = curves.get(key);
    if (!curve || indices.length === 0) continue;
    const last = Math.min(curve.times.length - 1, indices[indices.length - 1]);
    from = Math.min(from, curve.times[Math.min(last, indices[0])]);
    to = Math.max(to, curve.times[last]);
  }
  return from <= to ? [from, to] : null;
}
