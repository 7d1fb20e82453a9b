// A curve's component as a shape on the graph: paths in pixels, kept as long as neither the curve nor the scale changes.

import { handleShare } from "../../anim/bezier";
import { keyBefore } from "../../anim/curve";
import { evaluator } from "../../anim/timeline";
import { Mode, type EditCurve } from "../contract";
import type { Line } from "./tree";
import type { View } from "./view";

/** A line and where it is: shown value = factor * value + offset (degrees, or -1 to 1 in the normalised view). */
export interface Shape {
  readonly line: Line;
  readonly curve: EditCurve;
  readonly factor: number;
  readonly offset: number;
}

export const shownValue = ({ factor, offset }: Shape, value: number) => factor * value + offset;
export const valueOf = ({ factor, offset }: Shape, shown: number) => (shown - offset) / factor;

/** First and last key whose spans reach into a range of the clip's time. */
export function visibleKeys({ times }: EditCurve, from: number, to: number): [number, number] {
  const low = Math.min(from, to), high = Math.max(from, to);
  return [keyBefore(times, low), Math.min(times.length - 1, keyBefore(times, high) + 1)];
}

/** The part of CanvasPath that tracing needs. */
type Pen = Pick<CanvasPath, "moveTo" | "lineTo" | "bezierCurveTo">;

const value4 = new Float64Array(4);

/** Spans from key `from` to key `to`: x = kx * time + ox, y = oy - ky * value. */
export function trace(pen: Pen, { curve, line }: Shape, from: number, to: number, kx: number, ox: number, ky: number, oy: number): void {
  const { times, values, modes, components: width, inTangents, outTangents, inHandles, outHandles } = curve;
  const c = line.component;
  const x0 = kx * times[from] + ox, y0 = oy - ky * values[from * width + c];
  pen.moveTo(x0, y0);
  let xa = x0, ya = y0;
  // narrower than a pixel: only how far the curve goes up and down there
  let column = NaN, low = 0, high = 0;
  for (let k = from; k < to; k++) {
    const n = k * width + c, m = n + width;
    const xb = kx * times[k + 1] + ox, yb = oy - ky * values[m];
    const size = Math.abs(xb - xa);
    if (size < 0.8) {
      const at = Math.round(xb);
      if (at !== column) {
        if (column === column) {
          pen.lineTo(column, low);
          pen.lineTo(column, high);
        }
        column = at;
        low = high = yb;
      } else if (yb < low) low = yb;
      else if (yb > high) high = yb;
      xa = xb;
      ya = yb;
      continue;
    }
    if (column === column) {
      pen.lineTo(column, low);
      pen.lineTo(column, high);
      pen.lineTo(xa, ya);
      column = NaN;
    }
    const mode = modes[k];
    if (mode === Mode.Step) {
      pen.lineTo(xb, ya);
      pen.lineTo(xb, yb);
    } else if (size < 2.5 || (mode === Mode.Linear && curve.kind !== "rotation")) {
      pen.lineTo(xb, yb);
    } else if (curve.kind === "rotation") {
      const steps = Math.min(64, Math.ceil(size / 5)), sampler = evaluator(curve);
      const sign = signOf(curve, k);
      for (let s = 1; s < steps; s++) {
        const time = times[k] + ((times[k + 1] - times[k]) * s) / steps;
        sampler.sample(time, value4, 0);
        pen.lineTo(kx * time + ox, oy - ky * sign(value4) * value4[c]);
      }
      pen.lineTo(xb, yb);
    } else if (mode === Mode.Hermite && inTangents && outTangents) {
      const third = (times[k + 1] - times[k]) / 3, dx = (xb - xa) / 3;
      pen.bezierCurveTo(xa + dx, ya - ky * third * outTangents[n], xb - dx, yb + ky * third * inTangents[m], xb, yb);
    } else if (mode === Mode.Bezier && inHandles && outHandles) {
      const span = times[k + 1] - times[k];
      const a = handleShare(outHandles[2 * n], span), b = handleShare(inHandles[2 * m], span);
      pen.bezierCurveTo(
        xa + kx * a * outHandles[2 * n], ya - ky * a * outHandles[2 * n + 1],
        xb + kx * b * inHandles[2 * m], yb - ky * b * inHandles[2 * m + 1],
        xb, yb,
      );
    } else pen.lineTo(xb, yb);
    xa = xb;
    ya = yb;
  }
  if (column === column) {
    pen.lineTo(column, low);
    pen.lineTo(column, high);
  }
}

/** The sign that draws a sampled rotation on the side of the span's first key: q and -q are one rotation. */
function signOf({ values }: EditCurve, k: number): (q: Float64Array) => number {
  const w = values[4 * k], x = values[4 * k + 1], y = values[4 * k + 2], z = values[4 * k + 3];
  return (q) => (q[0] * w + q[1] * x + q[2] * y + q[3] * z < 0 ? -1 : 1);
}

interface Kept {
  path: Path2D;
  keys: Path2D;
  kx: number;
  ky: number;
  /** Time and value that the paths count from, and the clip's times that they cover. */
  time: number;
  value: number;
  from: number;
  to: number;
}

const kept = new WeakMap<EditCurve, (Kept | undefined)[]>();
/** How many paths were built: the tests look at it. */
export const counts = { built: 0, traced: 0, frames: 0, backdrops: 0 };

/** The whole visible line and its keys, as paths to draw at an offset. */
export function pathOf(shape: Shape, view: View): { path: Path2D; keys: Path2D; dx: number; dy: number } {
  const { curve, line } = shape;
  const kx = view.keyScale, ky = shape.factor * view.perUnit;
  let own = kept.get(curve);
  if (!own) kept.set(curve, (own = []));
  const left = view.clipTime(0), right = view.clipTime(view.width);
  const low = Math.min(left, right), high = Math.max(left, right);
  const y = (value: number) => view.toY(shownValue(shape, value));
  let found = own[line.component];
  if (!found || found.kx !== kx || found.ky !== ky || (low < found.from && found.from > curve.times[0]) || (high > found.to && found.to < curve.times[curve.times.length - 1]) || Math.abs(y(found.value)) > 1e6) {
    counts.built++;
    const margin = high - low, from = low - margin, to = high + margin;
    const time = (low + high) / 2, value = valueOf(shape, view.middle);
    const [first, last] = visibleKeys(curve, from, to);
    const path = new Path2D(), keys = new Path2D();
    trace(path, shape, first, last, kx, -kx * time, ky, ky * value);
    const { times, values, components: width } = curve;
    // keys that lie closer than they are wide would only blur the line
    const room = (Math.abs(kx) * (times[last] - times[first])) / Math.max(1, last - first);
    for (let k = first; k <= last && room > 4; k++) {
      const x = kx * (times[k] - time), yk = ky * (value - values[k * width + line.component]);
      if (room < 7) keys.rect(x - 1.25, yk - 1.25, 2.5, 2.5);
      else {
        keys.moveTo(x + 2.6, yk);
        keys.arc(x, yk, 2.6, 0, 2 * Math.PI);
      }
    }
    own[line.component] = found = { path, keys, kx, ky, time, value, from, to };
  }
  return { path: found.path, keys: found.keys, dx: view.clipX(found.time), dy: y(found.value) };
}

/** Before the first and after the last key: what extrapolation makes of the curve, to the edges of the view. */
export function traceOutside(pen: Pen, shape: Shape, view: View, pixels: number): void {
  const { curve, line } = shape;
  const { times, components, values } = curve;
  const y = (value: number) => view.toY(shownValue(shape, value));
  const end = times.length - 1;
  const xFirst = view.clipX(times[0]), xLast = view.clipX(times[end]);
  for (const [k, rule, near, edge] of [
    [0, curve.before, xFirst, xFirst <= xLast ? 0 : view.width],
    [end, curve.after, xLast, xFirst <= xLast ? view.width : 0],
  ] as const) {
    if (edge === 0 ? near <= 0 : near >= view.width) continue;
    const start = Math.max(-2, Math.min(view.width + 2, near));
    pen.moveTo(start, y(values[k * components + line.component]));
    if (rule === "hold" || end === 0) {
      pen.lineTo(edge, y(values[k * components + line.component]));
      continue;
    }
    const sampler = evaluator(curve);
    const steps = rule === "linear" && curve.kind !== "rotation" ? 1 : Math.ceil(Math.abs(edge - start) / pixels);
    for (let s = start === near ? 1 : 0; s <= steps; s++) {
      const x = start + ((edge - start) * s) / steps;
      sampler.sample(view.clipTime(x), value4, 0);
      if (s === 0) pen.moveTo(x, y(value4[line.component]));
      else pen.lineTo(x, y(value4[line.component]));
    }
  }
}

/** Value of a line at a time of the clip. */
export function lineValue({ curve, line }: Pick<Shape, "curve" | "line">, time: number): number {
  evaluator(curve).sample(time, value4, 0);
  return value4[line.component];
}

/** Seconds and value from a key to its handle on one side (0 before, 1 after); null where it has none. */
export function handleOf({ curve, line }: Pick<Shape, "curve" | "line">, key: number, side: 0 | 1): [number, number] | null {
  const { times, modes, components, kind } = curve;
  const span = side === 0 ? key - 1 : key;
  if (kind === "rotation" || span < 0 || span + 1 >= times.length) return null;
  const n = key * components + line.component;
  if (modes[span] === Mode.Bezier) {
    const handles = side === 0 ? curve.inHandles : curve.outHandles;
    return handles && [handles[2 * n], handles[2 * n + 1]];
  }
  if (modes[span] !== Mode.Hermite) return null;
  const tangents = side === 0 ? curve.inTangents : curve.outTangents;
  const third = ((times[span + 1] - times[span]) / 3) * (side === 0 ? -1 : 1);
  return tangents && [third, third * tangents[n]];
}

/** Lowest and highest shown value of a line between two times of the clip, handles and bends included. */
export function extent(shape: Shape, from = -Infinity, to = Infinity): [number, number] | null {
  const { curve, line } = shape;
  const { times, values, components, modes } = curve;
  let low = Infinity, high = -Infinity;
  const put = (value: number) => {
    const shown = shownValue(shape, value);
    low = Math.min(low, shown);
    high = Math.max(high, shown);
  };
  for (let k = 0; k < times.length; k++) {
    if (times[k] < from || times[k] > to) continue;
    put(values[k * components + line.component]);
    if (k + 1 < times.length && times[k + 1] <= to && modes[k] >= Mode.Hermite && times.length < 2000)
      for (const u of [0.25, 0.5, 0.75]) put(lineValue(shape, times[k] + u * (times[k + 1] - times[k])));
  }
  if (low > high && isFinite(from) && isFinite(to)) {
    put(lineValue(shape, from));
    put(lineValue(shape, to));
  }
  return low <= high ? [low, high] : null;
}
