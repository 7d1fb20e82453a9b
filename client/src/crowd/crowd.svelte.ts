// The state of the crowd page and its commands.

import type { CrowdFrame, CrowdMessage, CrowdReady } from "../generated/messages";
import type { Container } from "../net/container";
import { CrowdConnection } from "./connection";
import { Population } from "./population";
import type { CrowdLook } from "./stage";

export const COUNTS = [25, 50, 100, 150, 250, 400, 600, 1000, 2000];
export const SPEEDS = [0.1, 0.25, 0.5, 1, 2];
export const RATES = [60, 30, 15];

export class Crowd {
  graph = $state("sample:locomotion");
  count = $state(150);
  behaviour = $state("wander");
  seed = $state(1);
  paused = $state(false);
  speed = $state(1);
  rate = $state(30);
  look = $state<CrowdLook>({ byLevel: false, shadows: true, grid: true, orbit: true });
  followed = $state(-1);
  panel = $state(innerWidth > 900);

  ready = $state.raw<CrowdReady | null>(null);
  refused = $state("");
  opening = $state(false);
  online = $state(true);
  /** Rises about five times a second while frames come. */
  revision = $state(0);

  population: Population | null = null;
  frame: CrowdFrame | null = null;
  frames = 0;
  bytesPerSecond = 0;
  stepsPerSecond = 0;
  onShow: (container: Container<CrowdReady> | null, population: Population | null) => void = () => {};
  /** Go along with somebody, or with nobody (-1). */
  onFollow: (character: number) => void = () => {};
  private connection: CrowdConnection | null = null;
  private view: { eye: number[]; fov: number } | null = null;
  private acknowledged = 0;
  private revised = 0;
  private window = { began: 0, bytes: 0, steps: 0 };

  /** Connect when the page is first seen. */
  enter(): void {
    if (this.connection) return;
    this.opening = true;
    this.connection = new CrowdConnection(
      (container, bytes) => this.receive(container, bytes),
      (online) => {
        this.online = online;
        if (online) this.open();
      },
    );
  }

  /** Another crowd, with what is set now. */
  open(): void {
    this.opening = true;
    this.refused = "";
    this.followed = -1;
    this.connection?.send({ type: "crowd_open", graph: this.graph, count: this.count, behaviour: this.behaviour, seed: this.seed });
    this.sendPace();
    if (this.view) this.connection?.send({ type: "crowd_view", eye: this.view.eye, fov_deg: this.view.fov });
  }

  private receive(container: Container<CrowdMessage>, bytes: number): void {
    const { header } = container, now = performance.now();
    switch (header.type) {
      case "crowd_ready":
        this.population = new Population(header);
        this.ready = header;
        this.frame = null;
        this.acknowledged = 0;
        this.window = { began: now, bytes: 0, steps: 0 };
        this.onShow(container as Container<CrowdReady>, this.population);
        break;
      case "crowd_frame":
        if (header.crowd !== this.ready?.crowd || !this.population) return;
        this.population.receive(container as Container<CrowdFrame>, now);
        this.frame = header;
        this.frames++;
        this.opening = false;
        this.measure(bytes, now);
        break;
      case "crowd_failure":
        this.refused = header.message;
        this.opening = false;
        break;
    }
  }

  private measure(bytes: number, now: number): void {
    const { window } = this;
    window.bytes += bytes;
    window.steps++;
    const passed = (now - window.began) / 1000;
    if (passed >= 0.5) {
      this.bytesPerSecond = window.bytes / passed;
      this.stepsPerSecond = window.steps / passed;
      this.window = { began: now, bytes: 0, steps: 0 };
    }
    if (now - this.revised > 200) {
      this.revised = now;
      this.revision++;
    }
  }

  /** A picture with this step in it was drawn. */
  drawn(number: number): void {
    if (number <= this.acknowledged) return;
    this.acknowledged = number;
    this.connection?.send({ type: "crowd_acknowledge", number });
  }

  setView(eye: [number, number, number], fov: number): void {
    this.view = { eye, fov };
    this.connection?.send({ type: "crowd_view", eye, fov_deg: fov });
  }

  setBehaviour(behaviour: string): void {
    this.behaviour = behaviour;
    this.connection?.send({ type: "crowd_behave", behaviour });
  }

  setPace(change: { paused?: boolean; speed?: number; rate?: number }): void {
    this.paused = change.paused ?? this.paused;
    this.speed = change.speed ?? this.speed;
    this.rate = change.rate ?? this.rate;
    this.sendPace();
    this.revision++;
  }

  private sendPace(): void {
    this.connection?.send({ type: "crowd_pace", paused: this.paused, speed: this.speed, rate_hz: this.rate });
  }
}

export const crowd = new Crowd();
