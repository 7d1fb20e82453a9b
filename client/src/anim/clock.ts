// Time as the user plays it: a range, a speed, and what happens at its ends.

export type LoopMode = "loop" | "once" | "ping-pong";
export const LOOP_MODES: LoopMode[] = ["loop", "once", "ping-pong"];
export const SPEEDS = [0.1, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4];

export class Clock {
  time = 0;
  start = 0;
  end = 0;
  rate = 30;
  speed = 1;
  mode: LoopMode = "loop";
  playing = false;
  private direction = 1;

  setRange(start: number, end: number): void {
    this.start = start;
    this.end = Math.max(start, end);
    this.time = Math.min(this.end, Math.max(this.start, this.time));
  }

  play(): void {
    if (this.mode === "once" && this.time >= this.end) this.time = this.start;
    this.direction = 1;
    this.playing = true;
  }

  /** Move on by real seconds; returns whether it still plays. */
  advance(seconds: number): boolean {
    const span = this.end - this.start;
    if (span <= 0) {
      this.time = this.start;
      return this.playing;
    }
    let time = this.time + this.direction * this.speed * seconds;
    if (time > this.end || time < this.start) {
      if (this.mode === "loop") time = this.start + ((((time - this.start) % span) + span) % span);
      else if (this.mode === "once") {
        time = this.end;
        this.playing = false;
      } else {
        const phase = (((time - this.start) % (2 * span)) + 2 * span) % (2 * span);
        // past the end it comes back; before the start it goes forward again
        this.direction = time > this.end ? -1 : 1;
        time = phase <= span ? this.start + phase : this.start + 2 * span - phase;
      }
    }
    this.time = time;
    return this.playing;
  }

  get frame(): number {
    return Math.round((this.time - this.start) * this.rate * 1e6) / 1e6;
  }
}

/** Hours, minutes, seconds and frames. */
export function timecode(seconds: number, rate: number): string {
  const frames = Math.round(Math.abs(seconds) * rate);
  const whole = Math.max(1, Math.round(rate));
  const two = (n: number) => String(n).padStart(2, "0");
  const total = Math.floor(frames / whole);
  const sign = seconds < -1e-9 ? "-" : "";
  return `${sign}${two(Math.floor(total / 3600))}:${two(Math.floor(total / 60) % 60)}:${two(total % 60)}:${two(frames % whole)}`;
}
