// Where everybody is: the newest steps of the server, and what lies between them when a picture is drawn.

import type { CrowdFrame, CrowdReady } from "../generated/messages";
import { Arrays, type Container } from "../net/container";

const FULL_TURN = 2 * Math.PI;

/** The joints of all characters in one buffer, two rows each: the newest update and the one before it. */
export class Population {
  readonly count: number;
  /** Texels of four 16-bit numbers in a row: three for each joint. */
  readonly width: number;
  readonly joints: Int16Array;
  /** Weights of the faces' morphs, a row for each character; those of coarse levels stay as they were. */
  readonly morphs: Uint8Array<ArrayBuffer>;
  readonly level: Uint8Array;
  /** Place as it is drawn now: x, z, yaw. */
  readonly roots: Float32Array;
  /** Row of the newest joints, row of those before, how far between the two. */
  readonly rows: Float32Array;
  readonly inLevel: number[];
  time = 0;
  received = 0;
  updated = 0;
  /** Milliseconds from one step to the next, as they come. */
  interval = 33;
  fresh = false;

  private readonly from: Float32Array;
  private readonly to: Float32Array;
  private readonly began: Float64Array;
  private readonly lasts: Float32Array;
  private readonly drawnLevel: Int16Array;
  private readonly every: number[];
  private arrived = 0;
  private settled = true;

  constructor(readonly ready: CrowdReady) {
    this.count = ready.count;
    this.width = 3 * Math.max(...ready.levels.map((l) => l.palette));
    this.joints = new Int16Array(4 * this.width * 2 * this.count);
    this.morphs = new Uint8Array(Math.max(1, ready.morphs) * this.count);
    this.level = new Uint8Array(this.count);
    this.roots = new Float32Array(3 * this.count);
    this.rows = new Float32Array(3 * this.count);
    this.from = new Float32Array(3 * this.count);
    this.to = new Float32Array(3 * this.count);
    this.began = new Float64Array(this.count);
    this.lasts = new Float32Array(this.count);
    this.drawnLevel = new Int16Array(this.count).fill(-1);
    this.every = ready.levels.map((l) => l.every);
    this.inLevel = ready.levels.map(() => 0);
  }

  /** Take a step in; the picture goes there from where it is now. */
  receive(container: Container<CrowdFrame>, now: number): void {
    const { header } = container, arrays = new Arrays(container);
    const first = this.received === 0;
    if (!first && header.dt_s > 0) {
      const passed = Math.min(250, Math.max(4, now - this.arrived));
      this.interval += (passed - this.interval) * 0.15;
    }
    this.arrived = now;
    this.received = header.number;
    this.time = header.time_s;
    this.level.set(arrays.uint8(header.levels));
    this.inLevel.fill(0);
    for (const level of this.level) this.inLevel[level]++;
    this.from.set(this.roots);
    this.to.set(arrays.float32(header.roots));
    const jump = first || header.dt_s === 0;
    if (jump) this.from.set(this.to);
    this.settled = jump;
    header.updates.forEach((update, level) => {
      const who = arrays.uint16(update.who), raw = arrays.uint16(update.matrices);
      const values = new Int16Array(raw.buffer, raw.byteOffset, raw.length);
      const size = 12 * this.ready.levels[level].palette, faces = this.ready.morphs, weights = arrays.uint8(update.morphs);
      for (let n = 0; n < who.length; n++) {
        const character = who[n], o = 3 * character;
        const [newest, before] = this.drawnLevel[character] < 0 ? [2 * character, 2 * character + 1] : [this.rows[o + 1], this.rows[o]];
        if (weights.length > 0) this.morphs.set(weights.subarray(n * faces, (n + 1) * faces), faces * character);
        this.joints.set(values.subarray(n * size, (n + 1) * size), 4 * this.width * newest);
        const same = this.drawnLevel[character] === level && !jump;
        this.drawnLevel[character] = level;
        this.rows[o] = newest;
        this.rows[o + 1] = before;
        this.rows[o + 2] = same ? 0 : 1;
        this.began[character] = now;
        this.lasts[character] = same ? this.interval * this.every[level] : 0;
      }
      this.updated += who.length;
    });
    this.fresh = true;
  }

  /** Everything as it is at this moment; returns whether anything moved. */
  advance(now: number): boolean {
    const share = Math.min(1, (now - this.arrived) / this.interval);
    if (this.settled && !this.fresh) return false;
    const { from, to, roots, rows } = this;
    for (let n = 0; n < this.count; n++) {
      const o = 3 * n;
      roots[o] = from[o] + share * (to[o] - from[o]);
      roots[o + 1] = from[o + 1] + share * (to[o + 1] - from[o + 1]);
      const turn = to[o + 2] - from[o + 2];
      roots[o + 2] = from[o + 2] + share * (turn - FULL_TURN * Math.round(turn / FULL_TURN));
      if (rows[o + 2] < 1) rows[o + 2] = this.lasts[n] > 0 ? Math.min(1, (now - this.began[n]) / this.lasts[n]) : 1;
    }
    // characters of the slowest level take the longest to arrive
    this.settled = share >= 1 && now - this.arrived > this.interval * Math.max(...this.every);
    return true;
  }

  /** One character's morph weights, 0 to 1: for tests. */
  morphsOf(character: number): number[] {
    const { morphs } = this.ready;
    return Array.from(this.morphs.subarray(morphs * character, morphs * (character + 1)), (v) => v / 255);
  }

  /** One character's skin matrices as they were sent, 3x4 by rows in metres: for tests. */
  matricesOf(character: number): number[] {
    const size = 12 * this.ready.levels[this.drawnLevel[character]].palette, at = 4 * this.width * this.rows[3 * character];
    return Array.from(this.joints.subarray(at, at + size), (v, k) => (k % 4 === 3 ? v * this.ready.unit_m : v / 16384));
  }
}
