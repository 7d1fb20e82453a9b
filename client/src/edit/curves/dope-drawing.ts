// The dope sheet: a row for everything, each target, property and component; keys as diamonds, bars where nothing moves.

import { Mode, type EditCurve, type KeySelection } from "../contract";
import { hueOf, paint, type CurveColors } from "./colors";
import { isSelected } from "./selection";
import { visibleKeys } from "./shapes";
import type { Row } from "./tree";
import type { View } from "./view";

type Context = CanvasRenderingContext2D;
export const ROW = 22;

export interface DopeScene {
  readonly view: View;
  readonly colors: CurveColors;
  readonly rows: readonly Row[];
  readonly scroll: number;
  readonly curves: ReadonlyMap<string, EditCurve>;
  readonly selection: KeySelection;
  readonly locked: ReadonlySet<string>;
  readonly muted: ReadonlySet<string>;
  readonly hoveredRow: number;
  /** Colour of the layer's clip. */
  readonly tint: string;
  readonly clipFrom: number;
  readonly clipTo: number;
}

export const rowTop = (view: View, scroll: number, row: number) => view.top + row * ROW - scroll;

export function rowAt(view: View, scroll: number, y: number): number {
  return y < view.top ? -1 : Math.floor((y - view.top + scroll) / ROW);
}

/** The rows that can be seen: first, and one after the last. */
export function visibleRows({ view, scroll, rows }: Pick<DopeScene, "view" | "scroll" | "rows">): [number, number] {
  return [Math.max(0, Math.floor(scroll / ROW)), Math.min(rows.length, Math.ceil((scroll + view.plot) / ROW))];
}

export function drawRows(c: Context, scene: DopeScene): void {
  const { view, colors, rows, scroll, hoveredRow, tint } = scene;
  const [first, end] = visibleRows(scene);
  const from = view.clipX(scene.clipFrom), to = view.clipX(scene.clipTo);
  for (let r = first; r < end; r++) {
    const y = rowTop(view, scroll, r), { kind } = rows[r];
    c.fillStyle = kind === "all" || kind === "target" ? colors.raised : colors.ground;
    c.globalAlpha = kind === "all" ? 1 : kind === "target" ? 0.7 : 1;
    c.fillRect(0, y, view.width, ROW - 1);
    if (kind === "all" && to > from) {
      c.globalAlpha = 0.11;
      c.fillStyle = tint;
      c.fillRect(Math.max(0, from), y, Math.min(view.width, to) - Math.max(0, from), ROW - 1);
    }
    if (r === hoveredRow) {
      c.globalAlpha = 0.5;
      c.fillStyle = colors.hover;
      c.fillRect(0, y, view.width, ROW - 1);
    }
  }
  c.globalAlpha = 1;
}

const HELD = new WeakMap<EditCurve, Uint8Array>();

/** Spans over which a curve does not change. */
function heldSpans(curve: EditCurve): Uint8Array {
  const known = HELD.get(curve);
  if (known) return known;
  const { values, components: width, modes, inTangents, outTangents, inHandles, outHandles } = curve;
  const count = curve.times.length, out = new Uint8Array(count);
  for (let k = 0; k + 1 < count; k++) {
    let still = true;
    for (let c = 0; c < width && still; c++) {
      const n = k * width + c, m = n + width;
      still = values[n] === values[m];
      if (still && modes[k] === Mode.Hermite && inTangents && outTangents) still = outTangents[n] === 0 && inTangents[m] === 0;
      if (still && modes[k] === Mode.Bezier && inHandles && outHandles) still = outHandles[2 * n + 1] === 0 && inHandles[2 * m + 1] === 0;
    }
    out[k] = still ? 1 : 0;
  }
  HELD.set(curve, out);
  return out;
}

const SIZE = 4.4;

function diamond(c: CanvasPath, x: number, y: number, size: number): void {
  c.moveTo(x, y - size);
  c.lineTo(x + size, y);
  c.lineTo(x, y + size);
  c.lineTo(x - size, y);
  c.closePath();
}

function glyph(c: CanvasPath, x: number, y: number, mode: number): void {
  if (mode === Mode.Step) c.rect(x - 3.3, y - 3.3, 6.6, 6.6);
  else if (mode === Mode.Linear) {
    c.moveTo(x + 3.5, y);
    c.arc(x, y, 3.5, 0, 2 * Math.PI);
  } else diamond(c, x, y, SIZE);
}

let columns = new Uint8Array(0);

/** The keys of all rows that can be seen. */
export function drawKeys(c: Context, scene: DopeScene, only: ((row: Row) => boolean) | null = null): void {
  const { view, colors, rows, scroll, curves } = scene;
  const [first, end] = visibleRows(scene);
  const plain = new Path2D(), chosen = new Path2D(), quiet = new Path2D(), bars = new Path2D(), ticks = new Path2D();
  const sets: Paths = { plain, chosen, ticks, bars };
  for (let r = first; r < end; r++) {
    const row = rows[r];
    if (only && !only(row)) continue;
    const y = rowTop(view, scroll, r) + (ROW - 1) / 2;
    const own = row.channels.flatMap((key) => curves.get(key) ?? []);
    if (own.length === 0) continue;
    const still = row.channels.every((key) => scene.locked.has(key) || scene.muted.has(key));
    const paths = still ? { ...sets, plain: quiet, ticks: quiet } : sets;
    if (own.length === 1) single(scene, row, own[0], y, paths);
    else several(scene, own, y, paths);
  }
  c.fillStyle = colors.line;
  c.fill(bars);
  c.fillStyle = colors.faint;
  c.globalAlpha = 0.5;
  c.fill(quiet);
  c.globalAlpha = 1;
  c.fillStyle = colors.faint;
  c.fill(ticks);
  c.fillStyle = colors.muted;
  c.fill(plain);
  c.fillStyle = colors.accent;
  c.fill(chosen);
}

interface Paths {
  readonly plain: Path2D;
  readonly chosen: Path2D;
  /** Keys that lie too close for a diamond each. */
  readonly ticks: Path2D;
  readonly bars: Path2D;
}

/** Closer than this keys are no longer told apart: they become one band. */
const BAND = 3.4;

/** Keys from left to right that become bands: one for each run of the same state without a gap. */
class Bands {
  private from = NaN;
  private to = 0;
  private on = false;

  constructor(
    private readonly y: number,
    private readonly paths: Paths,
  ) {}

  put(x: number, on: boolean): void {
    if (Math.abs(x - this.to) > 2 * BAND || on !== this.on) {
      this.end();
      // where only the state changes nothing is left open between two bands
      this.from = Math.abs(x - this.to) > 2 * BAND ? x - 0.5 : this.to;
      this.on = on;
    }
    this.to = x + 0.5;
  }

  end(): void {
    if (this.from === this.from) (this.on ? this.paths.chosen : this.paths.ticks).rect(this.from, this.y - 2.5, this.to - this.from, 5);
  }
}

/** How wide a tick is where keys are so far apart: a gap stays between two of them. */
const tickWidth = (room: number) => Math.max(0.7, Math.min(1.8, 0.55 * room));

function single(scene: DopeScene, row: Row, curve: EditCurve, y: number, paths: Paths): void {
  const { plain, chosen, ticks, bars } = paths;
  const { view, selection } = scene;
  const { times, modes } = curve;
  const [from, to] = visibleKeys(curve, view.clipTime(-8), view.clipTime(view.width + 8));
  const kx = view.keyScale, ox = view.keyOffset;
  const room = Math.abs(kx * (times[to] - times[from])) / Math.max(1, to - from), dense = to > from && room < 6.5, wide = tickWidth(room);
  const held = heldSpans(curve);
  const component = row.kind === "component" ? row.component : -1;
  const indices = selection.get(curve.channel.key);
  const bands = dense && room < BAND ? new Bands(y, paths) : null;
  for (let k = from; k <= to; k++) {
    const x = kx * times[k] + ox;
    if (held[k]) {
      const next = kx * times[k + 1] + ox;
      bars.rect(Math.min(x, next), y - 3, Math.abs(next - x), 6);
    }
    const selected = indices !== undefined && isSelected(selection, curve.channel.key, k, component);
    if (bands) bands.put(x, selected);
    else if (dense) (selected ? chosen : ticks).rect(x - wide / 2, y - 4, wide, 8);
    else glyph(selected ? chosen : plain, x, y, modes[k]);
  }
  bands?.end();
}

/** Rows of several channels: one diamond for each pixel column that holds keys, selected where any is. */
function several(scene: DopeScene, curves: readonly EditCurve[], y: number, paths: Paths): void {
  const { plain, chosen, ticks } = paths;
  const { view, selection } = scene;
  const width = Math.ceil(view.width) + 16;
  if (columns.length < width) columns = new Uint8Array(width);
  else columns.fill(0, 0, width);
  const kx = view.keyScale, ox = view.keyOffset + 8.5;
  for (const curve of curves) {
    const { times } = curve;
    const [from, to] = visibleKeys(curve, view.clipTime(-8), view.clipTime(view.width + 8));
    for (let k = from; k <= to; k++) {
      const column = (kx * times[k] + ox) | 0;
      if (column >= 0 && column < width) columns[column] |= 1;
    }
    const indices = selection.get(curve.channel.key);
    if (!indices) continue;
    for (let n = 0; n < indices.length; n++) {
      if (indices[n] >= times.length) continue;
      const column = (kx * times[indices[n]] + ox) | 0;
      if (column >= 0 && column < width) columns[column] |= 2;
    }
  }
  let count = 0, first = -1, last = 0;
  for (let n = 0; n < width; n++) {
    if (!columns[n]) continue;
    count++;
    if (first < 0) first = n;
    last = n;
  }
  const room = (last - first) / Math.max(1, count - 1), dense = count > 1 && room < 6.5, wide = tickWidth(room);
  const bands = dense && room < BAND ? new Bands(y, paths) : null;
  for (let n = 0; n < width; n++) {
    if (!columns[n]) continue;
    const x = n - 8, on = (columns[n] & 2) !== 0;
    if (bands) bands.put(x, on);
    else if (dense) (on ? chosen : ticks).rect(x - wide / 2, y - 4, wide, 8);
    else diamond(on ? chosen : plain, x, y, SIZE + 0.4);
  }
  bands?.end();
}

export const hueOfLayer = (colors: CurveColors, name: string): string => paint(colors, hueOf(name));
