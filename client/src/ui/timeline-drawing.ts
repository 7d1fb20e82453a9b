// The timeline strip: ruler with frame numbers, keys, the played range and the playhead.

import type { Animation } from "../anim/animation";
import type { Rig } from "../anim/rig";

export interface TimelineColors {
  line: string;
  strong: string;
  muted: string;
  faint: string;
  accent: string;
  soft: string;
  raised: string;
  onAccent: string;
  mono: string;
}

/** Spans of time under the ruler, each [from, to, color, which half: 0 both, 1 upper, 2 lower]. */
export interface Lane {
  label: string;
  spans: readonly (readonly [number, number, string, 0 | 1 | 2])[];
}

export interface TimelineState {
  lanes: readonly Lane[];
  animation: Animation | null;
  rig: Rig | null;
  joint: number | null;
  time: number;
  start: number;
  end: number;
  toX: (time: number) => number;
}

const STEPS = [1, 2, 5, 10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000, 5000, 10000, 20000, 50000, 100000];
const RULER = 20;

export function drawTimeline(canvas: HTMLCanvasElement, width: number, height: number, colors: TimelineColors, state: TimelineState): void {
  const ratio = Math.min(2, devicePixelRatio);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d")!;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = `10px ${colors.mono}`;
  context.textBaseline = "middle";
  const { animation } = state;
  if (!animation) {
    context.fillStyle = colors.faint;
    context.textAlign = "center";
    context.fillText("No clip", width / 2, height / 2);
    return;
  }
  range(context, height, colors, state);
  ruler(context, width, height, colors, animation, state);
  if (state.lanes.length > 0) lanesOf(context, width, height, colors, state);
  else keys(context, height, colors, animation, state);
  playhead(context, height, colors, animation, state);
}

function range(c: CanvasRenderingContext2D, height: number, colors: TimelineColors, { animation, start, end, toX }: TimelineState): void {
  const x0 = toX(start), x1 = toX(end);
  c.fillStyle = colors.raised;
  c.fillRect(x0, 0, x1 - x0, RULER);
  const cut = start > animation!.start + 1e-9 || end < animation!.end - 1e-9;
  if (cut) {
    c.fillStyle = colors.soft;
    c.fillRect(x0, RULER, x1 - x0, height - RULER);
  }
  c.fillStyle = cut ? colors.accent : colors.strong;
  for (const [x, side] of [[x0, -1], [x1, 1]] as const) {
    c.beginPath();
    c.roundRect(side < 0 ? x - 4 : x, 3, 4, RULER - 6, 2);
    c.fill();
  }
}

function ruler(c: CanvasRenderingContext2D, width: number, height: number, colors: TimelineColors, animation: Animation, { time, toX }: TimelineState): void {
  const frames = Math.max(1, animation.frames - 1);
  const perFrame = (toX(animation.end) - toX(animation.start)) / frames;
  const label = STEPS.find((s) => s * perFrame >= 54) ?? STEPS.at(-1)!;
  const tick = STEPS.find((s) => s * perFrame >= 7 && label % s === 0) ?? label;
  c.textAlign = "left";
  for (let frame = 0; frame <= frames; frame += tick) {
    const x = Math.round(toX(animation.start + frame / animation.rate)) + 0.5;
    const major = frame % label === 0;
    c.strokeStyle = major ? colors.strong : colors.line;
    c.beginPath();
    c.moveTo(x, major ? 4 : RULER + 2);
    c.lineTo(x, major ? height : RULER + 6);
    c.stroke();
    // the number under the playhead is shown by the playhead
    if (major && x < width - 30 && Math.abs(x + 8 - toX(time)) > 24) {
      c.fillStyle = colors.faint;
      c.fillText(String(frame), x + 3.5, 10.5);
    }
  }
}

function keys(c: CanvasRenderingContext2D, height: number, colors: TimelineColors, animation: Animation, { rig, joint, toX }: TimelineState): void {
  if (!rig) return;
  const y = RULER + (height - RULER) / 2 + 1;
  const times = animation.keyTimes(rig, joint);
  // a motion has a sample at every frame: ticks, not keys that someone set
  const dense =
    animation.kind === "motion" || (times.length > 1 && (toX(times[times.length - 1]) - toX(times[0])) / (times.length - 1) < 5);
  c.fillStyle = joint === null ? colors.faint : colors.muted;
  let last = -10;
  for (let n = 0; n < times.length; n++) {
    const x = toX(times[n]);
    if (dense) {
      if (x - last < 2) continue;
      c.fillRect(Math.round(x), y - 3, 1, 6);
    } else {
      c.beginPath();
      c.moveTo(x, y - 4);
      c.lineTo(x + 4, y);
      c.lineTo(x, y + 4);
      c.lineTo(x - 4, y);
      c.fill();
    }
    last = x;
  }
}

function lanesOf(c: CanvasRenderingContext2D, width: number, height: number, colors: TimelineColors, { lanes, toX }: TimelineState): void {
  const top = RULER + 5, each = (height - top - 4) / lanes.length;
  c.textAlign = "left";
  lanes.forEach(({ label, spans }, n) => {
    const y = top + n * each, tall = each - 2;
    c.fillStyle = colors.raised;
    c.fillRect(0, y, width, tall);
    for (const [from, to, color, half] of spans) {
      c.fillStyle = color;
      c.beginPath();
      c.roundRect(toX(from), half === 2 ? y + tall / 2 + 0.5 : y, Math.max(2, toX(to) - toX(from)), half === 0 ? tall : tall / 2 - 0.5, 1.5);
      c.fill();
    }
    c.fillStyle = colors.faint;
    c.fillText(label, 10, y + tall / 2 + 0.5);
  });
}

function playhead(c: CanvasRenderingContext2D, height: number, colors: TimelineColors, animation: Animation, { time, toX }: TimelineState): void {
  const x = toX(time);
  const text = String(Math.floor((time - animation.start) * animation.rate + 1e-4));
  c.fillStyle = colors.accent;
  c.fillRect(x - 0.75, RULER - 4, 1.5, height - RULER + 4);
  const half = Math.max(11, c.measureText(text).width / 2 + 6);
  c.beginPath();
  c.roundRect(x - half, 2, 2 * half, RULER - 4, 4);
  c.fill();
  c.fillStyle = colors.onAccent;
  c.textAlign = "center";
  c.fillText(text, x, 10.5);
}
