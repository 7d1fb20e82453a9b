// Keyframe curves, evaluated exactly as keypose.evaluate.sample_curve does.

import { normalize, slerp, type Numbers } from "./rotation";

const STEP = 0;
const HERMITE = 2;

export interface CurveArrays {
  times: Float64Array;
  values: Numbers;
  modes: Uint8Array;
  inTangents: Numbers | null;
  outTangents: Numbers | null;
  before: string;
  after: string;
}

export class Curve {
  readonly keys: number;
  readonly width: number;
  private cursor = 0;

  constructor(
    readonly data: CurveArrays,
    private readonly rotation: boolean,
  ) {
    this.keys = data.times.length;
    this.width = data.values.length / this.keys;
  }

  /** Write the value at a time to out[at..]. */
  sample(time: number, out: Float64Array, at: number): void {
    const { times, before, after } = this.data;
    const first = times[0];
    const last = times[this.keys - 1];
    const span = last - first;
    let cycles = 0;
    if (time < first || time > last) {
      const rule = time < first ? before : after;
      if (span > 0 && (rule === "cycle" || rule === "cycle_offset")) {
        cycles = Math.floor((time - first) / span);
        time -= cycles * span;
        if (rule === "cycle") cycles = 0;
      } else if (span > 0 && rule === "ping_pong") {
        const cycle = Math.floor((time - first) / span);
        const phase = time - first - cycle * span;
        time = cycle % 2 === 0 ? first + phase : last - phase;
      } else if (span > 0 && rule === "linear" && !this.rotation) {
        this.extrapolate(time, time < first, out, at);
        return;
      }
    }
    this.inside(Math.max(first, Math.min(last, time)), out, at);
    if (cycles !== 0 && !this.rotation) {
      const { values } = this.data;
      const end = (this.keys - 1) * this.width;
      for (let c = 0; c < this.width; c++) out[at + c] += cycles * (values[end + c] - values[c]);
    }
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
    let low = 0, high = this.keys - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time) low = middle;
      else high = middle - 1;
    }
    return (this.cursor = low);
  }

  private inside(time: number, out: Float64Array, at: number): void {
    const { times, values, modes, inTangents, outTangents } = this.data;
    const width = this.width;
    const k = this.find(time);
    const i = k * width;
    const start = times[k];
    if (time === start || k + 1 >= this.keys || modes[k] === STEP) {
      for (let c = 0; c < width; c++) out[at + c] = values[i + c];
      if (this.rotation) normalize(out, at);
      return;
    }
    const j = i + width;
    const span = times[k + 1] - start;
    const u = (time - start) / span;
    if (modes[k] === HERMITE && inTangents && outTangents) {
      const u2 = u * u, u3 = u2 * u;
      const h00 = 2 * u3 - 3 * u2 + 1, h10 = (u3 - 2 * u2 + u) * span;
      const h01 = 3 * u2 - 2 * u3, h11 = (u3 - u2) * span;
      for (let c = 0; c < width; c++)
        out[at + c] = h00 * values[i + c] + h10 * outTangents[i + c] + h01 * values[j + c] + h11 * inTangents[j + c];
      if (this.rotation) normalize(out, at);
    } else if (this.rotation) {
      slerp(values, i, values, j, u, out, at);
    } else {
      for (let c = 0; c < width; c++) out[at + c] = values[i + c] + u * (values[j + c] - values[i + c]);
    }
  }

  private extrapolate(time: number, atStart: boolean, out: Float64Array, at: number): void {
    const { times, values, modes, inTangents, outTangents } = this.data;
    const width = this.width;
    const k = atStart ? 0 : this.keys - 1;
    const near = atStart ? 0 : this.keys - 2;
    const i = k * width;
    for (let c = 0; c < width; c++) {
      let slope = 0;
      if (modes[near] === HERMITE && inTangents && outTangents) slope = (atStart ? outTangents : inTangents)[i + c];
      else if (modes[near] !== STEP)
        slope = (values[(near + 1) * width + c] - values[near * width + c]) / (times[near + 1] - times[near]);
      out[at + c] = values[i + c] + slope * (time - times[k]);
    }
  }
}
