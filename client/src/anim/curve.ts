// Keyframe curves, evaluated exactly as keypose.evaluate.sample_curve does, in double precision.

import { bezierValue } from "./bezier";
import { exp, logShort, multiply, normalize, slerp, type Numbers } from "./rotation";
import { rotationControls, rotationSpline, type RotationMethod } from "./rotation-splines";

const STEP = 0;
const HERMITE = 2;
const BEZIER = 3;
const METHODS: Readonly<Record<number, RotationMethod>> = { 4: "squad", 5: "spherical-bezier", 6: "log-cubic" };

/** A curve's arrays; `EditCurve` of the editor is one, too. */
export interface CurveArrays {
  readonly kind: string;
  readonly times: Float64Array;
  readonly values: Numbers;
  readonly modes: Uint8Array;
  readonly inTangents: Numbers | null;
  readonly outTangents: Numbers | null;
  readonly inHandles: Numbers | null;
  readonly outHandles: Numbers | null;
  readonly before: string;
  readonly after: string;
}

export class Curve {
  readonly keys: number;
  readonly width: number;
  readonly rotation: boolean;
  private cursor = 0;
  /** Inner controls of the modes that exist for rotations alone, made when first needed. */
  private readonly controls = new Map<RotationMethod, Float64Array>();

  constructor(readonly data: CurveArrays) {
    this.keys = data.times.length;
    this.width = data.values.length / this.keys;
    this.rotation = data.kind === "rotation";
  }

  /** Write the value at a time to out[at..]. */
  sample(time: number, out: Float64Array, at: number): void {
    const { times, before, after } = this.data;
    const first = times[0], last = times[this.keys - 1], span = last - first;
    const early = time < first;
    if ((early || time > last) && span > 0) {
      const rule = early ? before : after;
      if (rule === "cycle" || rule === "cycle_offset") {
        const rest = modulo(time - first, span);
        const cycles = Math.round((time - first - rest) / span);
        this.inside(clamp(first + rest, first, last), out, at);
        if (rule === "cycle_offset" && this.data.kind !== "boolean") this.addCycles(cycles, out, at);
        return;
      }
      if (rule === "ping_pong") {
        const phase = modulo(time - first, 2 * span);
        time = first + Math.min(phase, 2 * span - phase);
      } else if (rule === "linear") {
        this.extend(time, early, out, at);
        return;
      }
    }
    this.inside(clamp(time, first, last), out, at);
  }

  /** The key at or before a time. Playing moves forward a little, so the search starts where it last ended. */
  private find(time: number): number {
    const { times } = this.data;
    let k = this.cursor;
    if (times[k] <= time) {
      for (let steps = 0; steps < 4; steps++) {
        if (k + 1 >= this.keys || times[k + 1] > time) return (this.cursor = k);
        k++;
      }
    }
    return (this.cursor = keyBefore(times, time));
  }

  private inside(time: number, out: Float64Array, at: number): void {
    const { times, values, modes, inTangents, outTangents, inHandles, outHandles } = this.data;
    const width = this.width;
    const k = this.find(time);
    const i = k * width;
    const start = times[k];
    const mode = modes[k];
    if (time === start || k + 1 >= this.keys || mode === STEP) {
      for (let c = 0; c < width; c++) out[at + c] = values[i + c];
      return;
    }
    const j = i + width;
    const span = times[k + 1] - start;
    const u = (time - start) / span;
    if (mode === HERMITE && inTangents && outTangents) {
      const v = 1 - u;
      const near = u < 0.5, w = near ? u * u * (3 - 2 * u) : v * v * (3 - 2 * v), bend = span * u * v;
      for (let c = 0; c < width; c++) {
        const p0 = values[i + c], p1 = values[j + c];
        out[at + c] = bend * (v * outTangents[i + c] - u * inTangents[j + c]) + (near ? p0 + w * (p1 - p0) : p1 - w * (p1 - p0));
      }
      if (this.rotation) normalize(out, at);
    } else if (mode === BEZIER && inHandles && outHandles) {
      for (let c = 0; c < width; c++) {
        const a = 2 * (i + c), b = 2 * (j + c);
        out[at + c] = bezierValue(u, span, values[i + c], outHandles[a], outHandles[a + 1], inHandles[b], inHandles[b + 1], values[j + c]);
      }
    } else if (this.rotation && METHODS[mode]) {
      const method = METHODS[mode];
      rotationSpline(method, values, this.controlsOf(method), k, u, out, at);
    } else if (this.rotation) {
      slerp(values, i, values, j, u, out, at);
    } else {
      for (let c = 0; c < width; c++) {
        const a = values[i + c], b = values[j + c], d = b - a;
        out[at + c] = u < 0.5 ? a + u * d : b - (1 - u) * d;
      }
    }
  }

  private controlsOf(method: RotationMethod): Float64Array {
    let found = this.controls.get(method);
    if (!found) this.controls.set(method, (found = rotationControls(method, this.data.values, this.data.times)));
    return found;
  }

  /** Each whole cycle starts where the one before it ended. */
  private addCycles(cycles: number, out: Float64Array, at: number): void {
    if (cycles === 0) return;
    const { values } = this.data;
    const end = (this.keys - 1) * this.width;
    if (!this.rotation) {
      for (let c = 0; c < this.width; c++) out[at + c] += cycles * (values[end + c] - values[c]);
      return;
    }
    // one cycle's turn to the power of their number, before the rotation inside the cycle
    turnBetween(values, 0, end, SCRATCH, 0);
    exp(cycles * SCRATCH[0], cycles * SCRATCH[1], cycles * SCRATCH[2], SCRATCH, 4);
    multiply(SCRATCH, 4, out, at, out, at);
  }

  /** Go on with the speed at the end: straight lines, and constant angular velocity for rotations. */
  private extend(time: number, atStart: boolean, out: Float64Array, at: number): void {
    const { times, values, modes, inTangents, outTangents, inHandles, outHandles } = this.data;
    const width = this.width;
    const near = atStart ? 0 : this.keys - 2;
    const i = (atStart ? 0 : this.keys - 1) * width;
    const elapsed = time - times[atStart ? 0 : this.keys - 1];
    const span = times[near + 1] - times[near];
    const mode = modes[near];
    if (mode === STEP) {
      for (let c = 0; c < width; c++) out[at + c] = values[i + c];
      return;
    }
    const tangents = mode === HERMITE ? (atStart ? outTangents : inTangents) : null;
    const handles = mode === BEZIER ? (atStart ? outHandles : inHandles) : null;
    if (!this.rotation) {
      const a = near * width, b = a + width;
      for (let c = 0; c < width; c++) {
        let slope = tangents ? tangents[i + c] : (values[b + c] - values[a + c]) / span;
        if (handles && handles[2 * (i + c)] !== 0) slope = handles[2 * (i + c) + 1] / handles[2 * (i + c)];
        out[at + c] = values[i + c] + slope * elapsed;
      }
      return;
    }
    if (tangents) {
      // q' = (half angular velocity) q; only the part along the sphere turns, normalising removes the other
      SCRATCH[4] = values[i]; SCRATCH[5] = -values[i + 1]; SCRATCH[6] = -values[i + 2]; SCRATCH[7] = -values[i + 3];
      multiply(tangents, i, SCRATCH, 4, SCRATCH, 0);
      exp(elapsed * SCRATCH[1], elapsed * SCRATCH[2], elapsed * SCRATCH[3], SCRATCH, 4);
    } else {
      turnBetween(values, near * 4, near * 4 + 4, SCRATCH, 0);
      const rate = elapsed / span;
      exp(rate * SCRATCH[0], rate * SCRATCH[1], rate * SCRATCH[2], SCRATCH, 4);
    }
    multiply(SCRATCH, 4, values, i, out, at);
  }
}

const SCRATCH = new Float64Array(12);

/** out = half-angle vector of the rotation that leads from q[i..] to q[j..]. */
function turnBetween(q: Numbers, i: number, j: number, out: Float64Array, o: number): void {
  SCRATCH[8] = q[i]; SCRATCH[9] = -q[i + 1]; SCRATCH[10] = -q[i + 2]; SCRATCH[11] = -q[i + 3];
  multiply(q, j, SCRATCH, 8, SCRATCH, 8);
  logShort(SCRATCH, 8, out, o);
}

/** Index of the last key at or before a time; 0 where all come later. */
export function keyBefore(times: ArrayLike<number>, time: number): number {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Index of the first key at or after a time; the number of keys where all come earlier. */
export function keyFrom(times: ArrayLike<number>, time: number): number {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Remainder with the sign of the divisor. */
function modulo(a: number, b: number): number {
  const rest = a % b;
  return rest < 0 ? rest + b : rest;
}

function clamp(x: number, low: number, high: number): number {
  return x < low ? low : x > high ? high : x;
}
