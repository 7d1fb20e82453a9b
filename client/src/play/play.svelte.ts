// The state of the play page and its commands: one graph that the server runs, and what it says about it.

import type { Envelope, PlayReady, PlayTake, ServerMessage } from "../generated/messages";
import { save } from "../net/download";
import type { Container } from "../net/container";
import { loadScene, type OpenFile } from "../scene";
import { studio } from "../studio.svelte";
import type { Actor } from "../view/actor";
import { Driver } from "./driver";
import { readFrame, type Frame } from "./frame";
import { History } from "./history";
import { rolesOf, type Roles } from "./roles";
import { Tree } from "./tree";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2];
export type LookMode = "off" | "pointer" | "camera";

/** All that belongs to one opened graph. */
export interface Playing {
  readonly ready: PlayReady;
  readonly tree: Tree;
  readonly roles: Roles;
  readonly driver: Driver;
  readonly history: History;
  readonly file: OpenFile;
  readonly actor: Actor;
  /** Where each parameter's numbers begin in `Frame.parameters`. */
  readonly slots: ReadonlyMap<string, number>;
}

export class Play {
  playing = $state.raw<Playing | null>(null);
  graphId = $state("");
  opening = $state(false);
  refused = $state("");
  paused = $state(false);
  speed = $state(1);
  look = $state<LookMode>("off");
  steering = $state<"camera" | "character">("camera");
  follow = $state(true);
  bones = $state(false);
  tab = $state("character");
  left = $state(innerWidth >= 1000);
  right = $state(innerWidth >= 780 && innerHeight >= 520);
  hints = $state(true);
  prints = $state(true);
  /** Which joint is explained, and which node is shown in detail. */
  joint = $state(-1);
  node = $state(-1);
  recordedS = $state<number | null>(null);
  takes = $state.raw<PlayTake[]>([]);
  /** Rises about ten times a second while the graph plays. */
  revision = $state(0);
  /** Rises when a key that drives went down or up. */
  pressed = $state(0);
  padName = $state("");

  frame: Frame | null = null;
  /** What was set last, by hand or by a key. */
  readonly values = new Map<string, number[]>();
  /** From an input to the first drawn frame that obeys it, in milliseconds, newest last. */
  latencies: number[] = [];
  stepsPerSecond = 0;
  received = 0;

  private sequence = 0;
  private waiting: { sequence: number; at: number }[] = [];
  private early: { message: Extract<ServerMessage, { type: "play_frame" }>; container: Container<Envelope> }[] = [];
  private player = -1;
  private revised = 0;
  private arrivals: number[] = [];

  constructor() {
    studio.messageListeners.add((message, container) => this.receive(message, container));
  }

  /** Play what the page begins with, or what was just dropped on it; once, so that another choice stays. */
  enter(first: string): void {
    if (first && first !== this.entered) this.open(first);
    this.entered = first;
  }
  private entered = "";

  open(graph: string): void {
    this.graphId = graph;
    this.opening = true;
    this.refused = "";
    this.paused = false;
    this.recordedS = null;
    studio.connection.send({ type: "play_open", graph });
  }

  private receive(message: ServerMessage, container: Container<Envelope>): void {
    switch (message.type) {
      case "hello":
        if (this.graphId) this.open(message.graphs.some((g) => g.id === this.graphId) ? this.graphId : message.graph);
        break;
      case "graph_ready":
        if (message.graph.id === this.graphId) this.open(this.graphId);
        break;
      case "failure":
        if (this.opening) this.refused = message.message;
        this.opening = false;
        break;
      case "play_ready":
        void this.begin(message);
        break;
      case "play_frame":
        if (message.player !== this.player) return;
        if (this.playing?.ready.player === this.player) this.take(readFrame(message, container));
        else this.early.push({ message, container });
        break;
      case "play_take":
        this.takes = [...this.takes.slice(-3), message];
        break;
    }
  }

  private async begin(ready: PlayReady): Promise<void> {
    this.player = ready.player;
    this.early = [];
    try {
      const scene = await studio.connection.scene<never>(ready.scene.id, ready.scene.bytes, () => {});
      const file = await loadScene(scene);
      if (this.player !== ready.player) return file.dispose();
      const roles = rolesOf(ready);
      let slot = 0;
      const slots = new Map(ready.parameters.map((p) => [p.name, (slot += p.default.length) - p.default.length]));
      const driver = new Driver(roles);
      driver.steering = this.steering;
      this.values.clear();
      for (const p of ready.parameters) this.values.set(p.name, p.default);
      this.waiting = [];
      this.frame = null;
      const tree = new Tree(ready);
      this.node = tree.nodes.find((n) => n.data.kind.startsWith("blend_"))?.index ?? tree.machines[0]?.index ?? 0;
      this.joint = -1;
      this.playing = { ready, tree, roles, driver, history: new History(ready), file, actor: file.actors[0], slots };
      this.opening = false;
      for (const { message, container } of this.early.splice(0)) this.take(readFrame(message, container));
    } catch (error) {
      this.opening = false;
      this.refused = error instanceof Error ? error.message : String(error);
    }
  }

  private take(frame: Frame): void {
    this.frame = frame;
    this.received++;
    this.playing!.history.push(frame);
    this.arrivals.push(frame.arrived);
    while (this.arrivals.length > 2 && frame.arrived - this.arrivals[0] > 1000) this.arrivals.shift();
    this.stepsPerSecond = this.arrivals.length > 1 ? ((this.arrivals.length - 1) * 1000) / Math.max(1, frame.arrived - this.arrivals[0]) : 0;
    if (frame.arrived - this.revised > 95 || this.paused || frame.data.changes.length > 0) {
      this.revised = frame.arrived;
      this.recordedS = frame.data.recorded_s;
      this.revision++;
    }
  }

  /** A frame is on the screen; the server may make the next step. */
  drawn(frame: Frame): void {
    const now = performance.now();
    while (this.waiting.length > 0 && this.waiting[0].sequence <= frame.data.heard) {
      this.latencies.push(now - this.waiting.shift()!.at);
      if (this.latencies.length > 32) this.latencies.shift();
    }
    studio.connection.send({ type: "play_acknowledge", number: frame.data.number });
  }

  get latency(): number {
    return this.latencies.length ? [...this.latencies].sort((a, b) => a - b)[this.latencies.length >> 1] : 0;
  }

  // ---- inputs ------------------------------------------------------------------------------------------------------

  /** Set parameters; `at` is when the user did it. */
  set(values: Record<string, number[]>, at = performance.now()): void {
    const names = Object.keys(values);
    if (names.length === 0 || !this.playing) return;
    for (const name of names) {
      const trigger = this.playing.ready.parameters.find((p) => p.name === name)?.kind === "trigger";
      if (!trigger) this.values.set(name, values[name]);
    }
    this.waiting.push({ sequence: ++this.sequence, at });
    if (this.waiting.length > 64) this.waiting.shift();
    studio.connection.send({ type: "play_input", sequence: this.sequence, values });
  }

  /** A key went down or up: what follows from it is sent at once, not with the next picture. */
  nudge(at: number): void {
    const { playing } = this;
    this.pressed++;
    if (playing && this.heading) this.set(playing.driver.update(this.heading(), this.frame?.data.root[2] ?? 0), at);
  }
  /** Where the camera looks; set by the stage. */
  heading: (() => number) | null = null;

  /** What a parameter is now: smoothed by the graph. */
  used(name: string): number[] {
    const slot = this.playing?.slots.get(name);
    const width = this.values.get(name)?.length ?? 1;
    return slot === undefined || !this.frame ? (this.values.get(name) ?? [0]) : [...this.frame.parameters.subarray(slot, slot + width)];
  }

  action(n: number, down: boolean, at = performance.now()): void {
    const { playing } = this;
    const role = playing?.roles.actions[n];
    if (!playing || !role) return;
    const value = playing.driver.action(role, down, this.values.get(role.name)?.[0] ?? role.off);
    if (value) this.set({ [role.name]: value }, at);
    this.revision++;
  }

  // ---- time --------------------------------------------------------------------------------------------------------

  private sendPace(): void {
    studio.connection.send({ type: "play_pace", paused: this.paused, speed: this.speed });
  }

  togglePause(): void {
    this.paused = !this.paused;
    this.sendPace();
  }

  step(): void {
    this.paused = true;
    studio.connection.send({ type: "play_step" });
  }

  setSpeed(speed: number): void {
    this.speed = speed;
    this.sendPace();
  }

  stepSpeed(direction: number): void {
    const next = direction > 0 ? SPEEDS.find((s) => s > this.speed) : SPEEDS.findLast((s) => s < this.speed);
    if (next !== undefined) this.setSpeed(next);
  }

  reset(): void {
    const { playing } = this;
    if (!playing) return;
    for (const p of playing.ready.parameters) this.values.set(p.name, p.default);
    playing.driver.forget();
    this.look = "off";
    this.recordedS = null;
    studio.connection.send({ type: "play_reset" });
  }

  explain(joint: number): void {
    this.joint = joint;
    studio.connection.send({ type: "play_explain", joint });
  }

  setSteering(steering: "camera" | "character"): void {
    this.steering = steering;
    if (this.playing) this.playing.driver.steering = steering;
  }

  cycleLook(): void {
    const modes: LookMode[] = ["off", "pointer", "camera"];
    this.setLook(modes[(modes.indexOf(this.look) + 1) % modes.length]);
  }

  setLook(mode: LookMode): void {
    this.look = mode;
    const weight = this.playing?.roles.look?.weight;
    if (weight) this.set({ [weight]: [mode === "off" ? 0 : 1] });
  }

  // ---- takes -------------------------------------------------------------------------------------------------------

  toggleRecording(): void {
    const on = this.recordedS === null;
    this.recordedS = on ? 0 : null;
    studio.connection.send({ type: "play_record", on });
  }

  async download(take: PlayTake, kind: "glb" | "bvh"): Promise<void> {
    try {
      save(await studio.connection.take(take.id, kind), `${take.name}.${kind}`);
    } catch (error) {
      studio.toast("error", "The recording was not saved", error instanceof Error ? error.message : String(error));
    }
  }

  dropTake(take: PlayTake): void {
    this.takes = this.takes.filter((t) => t !== take);
  }
}

export const play = new Play();
