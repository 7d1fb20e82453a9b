// What happened lately, as spans and marks for the time strip. Times are the graph's own.

import type { PlayReady } from "../generated/messages";
import type { Frame } from "./frame";

export interface Band {
  state: number;
  from: number;
  to: number;
}

export interface Span {
  from: number;
  to: number;
}

export interface Mark {
  time: number;
  name: string;
  clip: string;
}

export interface Cut {
  time: number;
  machine: number;
  source: number;
  target: number;
  kind: string;
  duration: number;
  interrupted: boolean;
}

const KEPT_S = 60;
const TOUCHING = 0.5;

export class History {
  readonly bands: Band[][];
  readonly contacts: Span[][];
  marks: Mark[] = [];
  cuts: Cut[] = [];
  now = 0;
  /** Of all events since the start, also those that have left the strip. */
  markCount = 0;
  private readonly touching: boolean[];
  private readonly machineIndex: Map<string, { row: number; states: string[] }>;

  constructor(ready: PlayReady) {
    const machines = ready.nodes.filter((n) => n.kind === "state_machine");
    this.bands = machines.map(() => []);
    this.machineIndex = new Map(machines.map((m, row) => [m.name, { row, states: m.states }]));
    this.contacts = ready.contacts.map(() => []);
    this.touching = ready.contacts.map(() => false);
  }

  push(frame: Frame): void {
    const { data } = frame;
    const time = data.time_s;
    if (time < this.now - 1e-6) this.clear();
    this.now = time;
    for (const change of data.changes) {
      const machine = this.machineIndex.get(change.machine)!;
      this.cuts.push({
        time: time - data.dt_s,
        machine: machine.row,
        source: machine.states.indexOf(change.source),
        target: machine.states.indexOf(change.target),
        kind: change.kind,
        duration: change.duration_s,
        interrupted: change.interrupted,
      });
    }
    for (const event of data.events) {
      this.marks.push({ time, name: event.name, clip: event.clip });
      this.markCount++;
    }
    this.bands.forEach((bands, row) => {
      const state = frame.machines[4 * row], last = bands.at(-1);
      if (last?.state === state) last.to = time;
      else {
        if (last) last.to = time - data.dt_s;
        bands.push({ state, from: last ? last.to : time - data.dt_s, to: time });
      }
    });
    this.contacts.forEach((spans, n) => {
      const touches = frame.contacts[n] >= TOUCHING;
      if (touches && !this.touching[n]) spans.push({ from: time - data.dt_s, to: time });
      else if (touches) spans[spans.length - 1].to = time;
      this.touching[n] = touches;
    });
    this.forget(time - KEPT_S);
  }

  private forget(before: number): void {
    for (const list of [...this.bands, ...this.contacts]) while (list.length > 1 && list[0].to < before) list.shift();
    while (this.marks.length > 0 && this.marks[0].time < before) this.marks.shift();
    while (this.cuts.length > 0 && this.cuts[0].time < before) this.cuts.shift();
  }

  clear(): void {
    for (const list of [...this.bands, ...this.contacts]) list.length = 0;
    this.touching.fill(false);
    this.marks = [];
    this.cuts = [];
    this.markCount = 0;
  }
}
