// Playing an animation: its time, the played range, speed and what happens at the ends, and the commands of the transport.

import type { Animation } from "./anim/animation";
import { LOOP_MODES, SPEEDS, type Clock, type LoopMode } from "./anim/clock";
import type { Rig } from "./anim/rig";

export abstract class Player {
  time = $state(0);
  playing = $state(false);
  mode = $state<LoopMode>("loop");
  speed = $state(1);
  start = $state(0);
  end = $state(0);
  readout = $state<"frames" | "seconds" | "timecode">("frames");
  /** The selected joint, or -1. */
  selected = $state(-1);
  /** Rises when the pose changed; at most ten times a second while playing. */
  revision = $state(0);
  /** Called with the time in every frame that changed; the timeline draws itself. */
  readonly frameListeners = new Set<() => void>();

  /** What sets the range and the rate. */
  abstract readonly animation: Animation | null;
  /** Whose keys are shown. */
  abstract rig(): Rig | null;
  protected abstract clock(): Clock;
  /** Time stands elsewhere: show it. */
  protected abstract reposed(): void;

  /** The exact time; `time` is what was shown last. */
  get now(): number {
    return this.clock().time;
  }

  get rate(): number {
    return this.animation?.rate ?? 30;
  }

  play(): void {
    if (!this.animation) return;
    this.clock().play();
    this.playing = true;
  }

  pause(): void {
    this.clock().playing = this.playing = false;
    this.revision++;
  }

  toggle(): void {
    if (this.playing) this.pause();
    else this.play();
  }

  seek(time: number): void {
    const clock = this.clock();
    clock.time = Math.max(clock.start, Math.min(clock.end, time));
    this.time = clock.time;
    this.reposed();
  }

  /** Go to a whole frame, counted from the start of the animation. */
  seekFrame(frame: number): void {
    this.seek((this.animation?.start ?? 0) + frame / this.rate);
  }

  step(frames: number): void {
    this.pause();
    const frame = (this.clock().time - (this.animation?.start ?? 0)) * this.rate;
    // from between two frames, a step goes to the next whole one
    this.seekFrame(frames > 0 ? Math.floor(frame + 1e-6) + frames : Math.ceil(frame - 1e-6) + frames);
  }

  toStart(): void {
    this.seek(this.start);
  }

  toEnd(): void {
    this.seek(this.end);
  }

  /** To the neighbouring key of the selected joint, or of any. */
  seekKey(direction: number): void {
    const { animation } = this, rig = this.rig();
    if (!animation || !rig) return;
    this.pause();
    const times = animation.keyTimes(rig, this.selected >= 0 ? this.selected : null);
    const now = this.clock().time;
    const next = direction > 0 ? times.find((t) => t > now + 1e-6) : times.findLast((t) => t < now - 1e-6);
    if (next !== undefined) this.seek(next);
  }

  setRange(start: number, end: number): void {
    const low = this.animation?.start ?? 0, high = this.animation?.end ?? 0;
    const shortest = Math.min(high - low, 1 / this.rate);
    this.start = Math.max(low, Math.min(start, high - shortest));
    this.end = Math.min(high, Math.max(end, this.start + shortest));
    this.clock().setRange(this.start, this.end);
    this.reposed();
  }

  resetRange(): void {
    this.setRange(this.animation?.start ?? 0, this.animation?.end ?? 0);
  }

  setSpeed(speed: number): void {
    this.speed = Math.max(0.1, Math.min(4, Math.round(speed * 100) / 100));
    this.clock().speed = this.speed;
  }

  stepSpeed(direction: number): void {
    const next = direction > 0 ? SPEEDS.find((s) => s > this.speed) : SPEEDS.findLast((s) => s < this.speed);
    if (next !== undefined) this.setSpeed(next);
  }

  setMode(mode: LoopMode): void {
    this.mode = this.clock().mode = mode;
  }

  cycleMode(): void {
    this.setMode(LOOP_MODES[(LOOP_MODES.indexOf(this.mode) + 1) % LOOP_MODES.length]);
  }
}
