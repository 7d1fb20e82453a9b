// The graph: grid, lines, keys, handles. What does not change while something is dragged is drawn once, into a backdrop.

import type { EditCurve, KeySelection } from "../contract";
import { paint, type CurveColors } from "./colors";
import { masksOf } from "./selection";
import { counts, handleOf, pathOf, shownValue, trace, traceOutside, visibleKeys, type Shape } from "./shapes";
import { valueStep, type Box, type View } from "./view";

type Context = CanvasRenderingContext2D;

/** Keys of a channel whose spans a drag may change: pairs of first and last key of the curve as it was. */
export type Ranges = readonly (readonly [number, number])[];

/** Every span that moving these keys can change: their own, and as far as automatic tangents reach. */
export function affected(curve: EditCurve, indices: Uint32Array): Ranges {
  const out: [number, number][] = [], end = curve.times.length - 1;
  for (const k of indices) {
    const from = Math.max(0, k - 2), to = Math.min(end, k + 2), last = out[out.length - 1];
    if (last && from <= last[1]) last[1] = to;
    else out.push([from, to]);
  }
  return out;
}

/** What lies between ranges. */
function complement(ranges: readonly (readonly [number, number])[], end: number): [number, number][] {
  const out: [number, number][] = [];
  let from = 0;
  for (const [first, last] of ranges) {
    if (first > from) out.push([from, first]);
    from = last;
  }
  if (from < end) out.push([from, end]);
  return out;
}

export function drawGrid(c: Context, view: View, colors: CurveColors, degrees: boolean): void {
  const { step, digits } = valueStep(view.perUnit);
  const first = Math.ceil(view.toValue(view.height) / step), last = Math.floor(view.toValue(view.top) / step);
  c.lineWidth = 1;
  for (let n = first; n <= last; n++) {
    const y = Math.round(view.toY(n * step)) + 0.5;
    c.strokeStyle = n === 0 ? colors.strong : colors.line;
    c.globalAlpha = n === 0 ? 1 : 0.75;
    c.beginPath();
    c.moveTo(0, y);
    c.lineTo(view.width, y);
    c.stroke();
  }
  c.globalAlpha = 1;
  c.font = `9.5px ${colors.mono}`;
  c.textAlign = "left";
  c.textBaseline = "middle";
  for (let n = first; n <= last; n++) {
    const y = view.toY(n * step), text = `${(n * step).toFixed(digits)}${degrees ? "°" : ""}`.replace(/^-(0(\.0+)?°?)$/, "$1");
    if (y < view.top + 8 || y > view.height - 6) continue;
    c.fillStyle = colors.ground;
    c.globalAlpha = 0.78;
    c.fillRect(3, y - 6, c.measureText(text).width + 6, 12);
    c.globalAlpha = 1;
    c.fillStyle = colors.faint;
    c.fillText(text, 6, y + 0.5);
  }
}

export interface GraphScene {
  readonly view: View;
  readonly colors: CurveColors;
  readonly shapes: readonly Shape[];
  readonly selection: KeySelection;
  /** Channels that cannot be edited, and lines that do not count: drawn thin. */
  readonly locked: ReadonlySet<string>;
  readonly muted: ReadonlySet<string>;
  readonly hovered: string;
}

/**
 * Lines and keys at rest. Of channels that are being dragged a ghost of what moves, and what stays as it is, unless that
 * has a picture of its own (`apart`).
 */
export function drawLines(c: Context, scene: GraphScene, dragged: ReadonlyMap<string, Ranges> | null, apart = false): void {
  const { view, colors, shapes, selection, locked, muted } = scene;
  const many = shapes.length > 60, { hair, plain, bold } = widths(scene);
  for (const shape of shapes) {
    const { line, curve } = shape;
    const moving = dragged?.get(line.channel);
    const active = selection.has(line.channel), quiet = locked.has(line.channel) || muted.has(line.channel);
    c.strokeStyle = c.fillStyle = paint(colors, line.hue);
    const strength = quiet ? 0.28 : many && !active ? (shapes.length > 150 ? 0.4 : 0.6) : 0.95;
    c.lineWidth = active ? bold : plain;
    c.globalAlpha = strength * (moving === undefined ? 0.45 : 0.2);
    c.setLineDash(many || (curve.before === "hold" && curve.after === "hold") ? [] : [4, 3]);
    c.beginPath();
    traceOutside(c, shape, view, many ? 3 : 1);
    c.stroke();
    c.setLineDash(muted.has(line.channel) ? [5, 4] : []);
    c.globalAlpha = strength;
    if (moving === undefined) {
      const { path, keys, dx, dy } = pathOf(shape, view);
      c.translate(dx, dy);
      c.stroke(path);
      if (!locked.has(line.channel)) c.fill(keys);
      c.translate(-dx, -dy);
      continue;
    }
    const parts = apart ? [] : complement(moving, curve.times.length - 1);
    c.beginPath();
    for (const [from, to] of parts) part(c, shape, view, from, to);
    c.stroke();
    for (const [from, to] of parts) dots(c, shape, view, from, to);
    // where the keys were
    c.globalAlpha = 0.34;
    c.setLineDash(many ? [] : [3, 3]);
    c.lineWidth = hair;
    c.beginPath();
    for (const [from, to] of moving) part(c, shape, view, from, to);
    c.stroke();
    c.setLineDash([]);
  }
  c.globalAlpha = 1;
  c.setLineDash([]);
}

function part(c: Context, shape: Shape, view: View, from: number, to: number): void {
  const [first, last] = visibleKeys(shape.curve, view.clipTime(0), view.clipTime(view.width));
  const a = Math.max(from, first), b = Math.min(to, last);
  if (a > b) return;
  counts.traced += b - a;
  trace(c, shape, a, b, view.keyScale, view.keyOffset, shape.factor * view.perUnit, view.toY(shape.offset));
}

/** Keys as squares, where they have room. */
function dots(c: Context, { curve, line, factor, offset }: Shape, view: View, from: number, to: number): void {
  const { times, values, components } = curve;
  const kx = view.keyScale, ox = view.keyOffset, ky = factor * view.perUnit, oy = view.toY(offset);
  if (Math.abs(kx) * (times[to] - times[from]) < 4 * (to - from)) return;
  for (let k = from; k <= to; k++) {
    const x = kx * times[k] + ox;
    if (x > -4 && x < view.width + 4) c.fillRect(x - 2, oy - ky * values[k * components + line.component] - 2, 4, 4);
  }
}

/** The lines of channels that are being dragged, as they were: what keys pass is cut out of this picture. */
export function drawBase(c: Context, scene: GraphScene, dragged: ReadonlyMap<string, Ranges>): void {
  drawLines(c, { ...scene, shapes: scene.shapes.filter((s) => dragged.has(s.line.channel)) }, null);
}

/** What a drag changes: the moved spans or, once keys have passed others, everything in an interval of the clip's time. */
export function drawMoved(c: Context, scene: GraphScene, dragged: ReadonlyMap<string, Ranges>, interval: readonly [number, number] | null): void {
  const { view, colors, shapes } = scene;
  const { bold } = widths(scene);
  for (const shape of shapes) {
    const { line, curve } = shape;
    const own = dragged.get(line.channel);
    if (!own) continue;
    const ranges = interval ? [visibleKeys(curve, interval[0], interval[1])] : own;
    c.strokeStyle = c.fillStyle = paint(colors, line.hue);
    c.lineWidth = bold;
    c.beginPath();
    for (const [from, to] of ranges) part(c, shape, view, from, to);
    c.stroke();
    for (const [from, to] of ranges) dots(c, shape, view, from, to);
  }
}

/** Thin where there is much to draw: lines wider than a pixel cost software renderers a hundred times as much. */
function widths({ shapes, view }: GraphScene): { hair: number; plain: number; bold: number } {
  const hair = 1 / Math.min(2, devicePixelRatio);
  let spans = 0;
  for (const { curve } of shapes) {
    const [first, last] = visibleKeys(curve, view.clipTime(0), view.clipTime(view.width));
    spans += last - first;
  }
  return spans > 3000 || shapes.length > 60 ? { hair, plain: hair, bold: hair } : { hair, plain: 1.3, bold: 1.6 };
}

export const HANDLES = 240;
/** Handles nearer to their key than this are not drawn: they would only blur it. */
export const LEAST_REACH = 9;
let taken = new Uint8Array(0);

/** Selected keys, with their handles where there are not too many to tell apart. */
export function drawSelected(c: Context, scene: GraphScene): void {
  const { view, colors, shapes, selection } = scene;
  const columns = Math.ceil(view.width / 3) + 2, cells = columns * (Math.ceil(view.height / 3) + 2);
  if (taken.length < cells) taken = new Uint8Array(cells);
  else taken.fill(0, 0, cells);
  const points: number[] = [];
  const withHandles: [Shape, number][] = [];
  const kx = view.keyScale, ox = view.keyOffset;
  for (const shape of shapes) {
    const indices = selection.get(shape.line.channel);
    if (!indices) continue;
    const mask = masksOf(indices), { curve, line } = shape, width = curve.components;
    const ky = shape.factor * view.perUnit, oy = view.toY(shape.offset);
    for (let n = 0; n < indices.length; n++) {
      if (mask && !((mask[n] >> line.component) & 1)) continue;
      const k = indices[n];
      if (k >= curve.times.length) continue;
      const x = kx * curve.times[k] + ox;
      if (x < -80 || x > view.width + 80) continue;
      if (withHandles.length <= HANDLES) withHandles.push([shape, k]);
      const y = oy - ky * curve.values[k * width + line.component];
      if (x < -4 || x > view.width + 4 || y < view.top - 4 || y > view.height + 4) continue;
      const cell = (((y + 6) / 3) | 0) * columns + (((x + 6) / 3) | 0);
      if (cell < cells && taken[cell]) continue;
      taken[cell] = 1;
      points.push(x, y);
    }
  }
  if (withHandles.length <= HANDLES) for (const [shape, k] of withHandles) handles(c, scene, shape, k);
  const radius = points.length > 1200 ? 2.2 : 3.6;
  c.fillStyle = colors.accent;
  if (radius < 3) {
    for (let n = 0; n < points.length; n += 2) c.fillRect(points[n] - radius, points[n + 1] - radius, 2 * radius, 2 * radius);
    return;
  }
  c.beginPath();
  for (let n = 0; n < points.length; n += 2) {
    c.moveTo(points[n] + radius, points[n + 1]);
    c.arc(points[n], points[n + 1], radius, 0, 2 * Math.PI);
  }
  c.fill();
  c.strokeStyle = colors.ground;
  c.lineWidth = 1;
  c.stroke();
}

function handles(c: Context, { view, colors }: GraphScene, shape: Shape, k: number): void {
  const { curve, line } = shape;
  const value = curve.values[k * curve.components + line.component];
  const x = view.clipX(curve.times[k]), y = view.toY(shownValue(shape, value));
  for (const side of [0, 1] as const) {
    const reach = handleOf(shape, k, side);
    if (!reach) continue;
    const hx = view.clipX(curve.times[k] + reach[0]), hy = view.toY(shownValue(shape, value + reach[1]));
    if (Math.hypot(hx - x, hy - y) < LEAST_REACH) continue;
    c.strokeStyle = colors.muted;
    c.globalAlpha = 0.8;
    c.lineWidth = 1;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(hx, hy);
    c.stroke();
    c.globalAlpha = 1;
    c.fillStyle = colors.ground;
    c.strokeStyle = curve.types && curve.types[2 * k + side] >= 2 ? colors.muted : colors.accent;
    c.lineWidth = 1.3;
    c.beginPath();
    c.arc(hx, hy, 3, 0, 2 * Math.PI);
    c.fill();
    c.stroke();
  }
}

/** The value of every line at the playhead. */
export function drawValues(c: Context, scene: GraphScene, x: number, values: readonly number[]): void {
  const { view, colors, shapes } = scene;
  if (shapes.length > 24) return;
  shapes.forEach(({ line }, n) => {
    const y = view.toY(values[n]);
    if (y < view.top || y > view.height) return;
    c.fillStyle = colors.ground;
    c.strokeStyle = paint(colors, line.hue);
    c.lineWidth = 1.5;
    c.beginPath();
    c.arc(x, y, 2.6, 0, 2 * Math.PI);
    c.fill();
    c.stroke();
  });
}

/** The box around the selection with grips to scale it by. */
export function drawTransformBox(c: Context, { x0, y0, x1, y1 }: Box, colors: CurveColors, grips: readonly (readonly [number, number])[]): void {
  c.strokeStyle = colors.accent;
  c.globalAlpha = 0.5;
  c.lineWidth = 1;
  c.setLineDash([3, 3]);
  c.strokeRect(Math.round(x0) + 0.5, Math.round(y0) + 0.5, Math.round(x1 - x0), Math.round(y1 - y0));
  c.setLineDash([]);
  c.globalAlpha = 1;
  c.fillStyle = colors.ground;
  for (const [x, y] of grips) {
    c.beginPath();
    c.rect(Math.round(x) - 3, Math.round(y) - 3, 6, 6);
    c.fill();
    c.stroke();
  }
}

export function drawBox(c: Context, { x0, y0, x1, y1 }: Box, colors: CurveColors, remove: boolean): void {
  c.fillStyle = colors.soft;
  c.strokeStyle = remove ? colors.danger : colors.accent;
  c.lineWidth = 1;
  c.setLineDash(remove ? [4, 3] : []);
  c.fillRect(x0, y0, x1 - x0, y1 - y0);
  c.strokeRect(Math.round(x0) + 0.5, Math.round(y0) + 0.5, Math.round(x1 - x0), Math.round(y1 - y0));
  c.setLineDash([]);
}
