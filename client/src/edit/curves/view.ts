// Where times and values are on the canvas: one time axis for graph and dope sheet, one axis of values for the graph.

export interface Box {
  readonly x0: number;
  readonly y0: number;
  readonly x1: number;
  readonly y1: number;
}

/** clip time = speed * timeline time + shift: where a placement puts the clip. */
export interface ClipMap {
  readonly speed: number;
  readonly shift: number;
}

const LEAST_SPAN = 1e-3, MOST_SPAN = 1e5;

export class View {
  width = 1;
  height = 1;
  /** Height of ruler and markers above the drawing. */
  top = 0;
  /** Timeline seconds at the left edge. */
  left = 0;
  perSecond = 100;
  /** Shown value in the middle of the drawing, and pixels of one unit of it. */
  middle = 0;
  perUnit = 60;
  clip: ClipMap = { speed: 1, shift: 0 };

  get plot(): number {
    return Math.max(1, this.height - this.top);
  }

  toX(time: number): number {
    return (time - this.left) * this.perSecond;
  }

  toTime(x: number): number {
    return this.left + x / this.perSecond;
  }

  toY(value: number): number {
    return this.top + this.plot / 2 - (value - this.middle) * this.perUnit;
  }

  toValue(y: number): number {
    return this.middle + (this.top + this.plot / 2 - y) / this.perUnit;
  }

  /** x = keyScale * (clip time) + keyOffset. */
  get keyScale(): number {
    return this.perSecond / this.clip.speed;
  }

  get keyOffset(): number {
    return (-this.clip.shift / this.clip.speed - this.left) * this.perSecond;
  }

  /** The clip's time at a place on the canvas, and the other way round. */
  clipTime(x: number): number {
    return this.clip.speed * this.toTime(x) + this.clip.shift;
  }

  clipX(time: number): number {
    return this.toX((time - this.clip.shift) / this.clip.speed);
  }

  pan(dx: number, dy: number): void {
    this.left -= dx / this.perSecond;
    this.middle += dy / this.perUnit;
  }

  zoomTime(factor: number, x: number): void {
    const time = this.toTime(x);
    const least = this.width / MOST_SPAN, most = this.width / LEAST_SPAN;
    this.perSecond = Math.max(least, Math.min(most, this.perSecond * factor));
    this.left = time - x / this.perSecond;
  }

  zoomValue(factor: number, y: number): void {
    const value = this.toValue(y);
    this.perUnit = Math.max(1e-6, Math.min(1e9, this.perUnit * factor));
    this.middle += value - this.toValue(y);
  }

  /** Show these timeline seconds with a margin. */
  fitTime(start: number, end: number, least = 0.2): void {
    const span = Math.max(end - start, least), margin = Math.min(48, this.width * 0.06);
    const middle = (start + end) / 2;
    this.perSecond = Math.max(1, this.width - 2 * margin) / span;
    this.left = middle - this.width / 2 / this.perSecond;
  }

  fitValue(low: number, high: number, least = 1e-3): void {
    const span = Math.max(high - low, least), margin = Math.min(28, this.plot * 0.12);
    this.perUnit = Math.max(1, this.plot - 2 * margin) / span;
    this.middle = (low + high) / 2;
  }

  state(): readonly number[] {
    return [this.width, this.height, this.top, this.left, this.perSecond, this.middle, this.perUnit, this.clip.speed, this.clip.shift];
  }
}

const FRAME_STEPS = [1, 2, 5, 10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000, 5000, 10000, 20000, 50000, 100000, 1000000];

/** Frames between labels and between ticks. */
export function frameSteps(perFrame: number): { label: number; tick: number } {
  const label = FRAME_STEPS.find((s) => s * perFrame >= 58) ?? 1000000;
  const tick = FRAME_STEPS.find((s) => s * perFrame >= 8 && label % s === 0) ?? label;
  return { label, tick };
}

/** A round step of values that is at least so many pixels, and the digits that its labels need. */
export function valueStep(perUnit: number, pixels = 34): { step: number; digits: number } {
  const raw = pixels / perUnit, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((s) => s * power >= raw * 0.999)! * power;
  return { step, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

export const ordered = (x0: number, y0: number, x1: number, y1: number): Box => ({
  x0: Math.min(x0, x1),
  y0: Math.min(y0, y1),
  x1: Math.max(x0, x1),
  y1: Math.max(y0, y1),
});
