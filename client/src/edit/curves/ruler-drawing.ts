// What graph and dope sheet share: frame lines, the ruler with the range, markers and the playhead.

import type { EditMarker } from "../contract";
import { fitted } from "../../play/colors";
import type { CurveColors } from "./colors";
import { frameSteps, type View } from "./view";

type Context = CanvasRenderingContext2D;
export const RULER = 24;
export const MARKERS = 17;

export interface RulerState {
  readonly rate: number;
  readonly start: number;
  readonly end: number;
  readonly time: number;
  readonly markers: readonly EditMarker[];
  /** Selected time. */
  readonly span: readonly [number, number] | null;
  /** Timeline seconds of the clip and how it is called; null where its placement says nothing. */
  readonly clip: { readonly from: number; readonly to: number; readonly hue: string } | null;
}

/** Frame lines over the plot, a veil on what lies outside the range, and the selected time. */
export function drawFrames(c: Context, view: View, colors: CurveColors, { rate, start, end, span }: RulerState): void {
  const { label, tick } = frameSteps(view.perSecond / rate);
  const first = Math.ceil((view.left * rate) / tick) * tick, last = view.toTime(view.width) * rate;
  c.lineWidth = 1;
  for (const major of [false, true]) {
    c.strokeStyle = colors.line;
    c.globalAlpha = major ? 0.95 : 0.4;
    c.beginPath();
    for (let frame = first; frame <= last; frame += tick) {
      if ((frame % label === 0) !== major) continue;
      const x = Math.round(view.toX(frame / rate)) + 0.5;
      c.moveTo(x, view.top);
      c.lineTo(x, view.height);
    }
    c.stroke();
  }
  c.globalAlpha = colors.dark ? 0.34 : 0.055;
  c.fillStyle = "#000";
  const x0 = Math.min(view.width, view.toX(start)), x1 = Math.max(0, view.toX(end));
  if (x0 > 0) c.fillRect(0, view.top, x0, view.plot);
  if (x1 < view.width) c.fillRect(x1, view.top, view.width - x1, view.plot);
  if (span) {
    const [a, b] = span.map((time) => view.toX(time));
    c.fillStyle = c.strokeStyle = colors.accent;
    c.globalAlpha = colors.dark ? 0.09 : 0.1;
    c.fillRect(a, view.top, b - a, view.plot);
    c.globalAlpha = 0.55;
    for (const x of [a, b]) c.fillRect(Math.round(x), view.top, 1, view.plot);
  }
  c.globalAlpha = 1;
}

export function drawRuler(c: Context, view: View, colors: CurveColors, state: RulerState): void {
  const { rate, start, end, time, markers, span, clip } = state;
  c.fillStyle = colors.panel;
  c.fillRect(0, 0, view.width, view.top);
  const x0 = view.toX(start), x1 = view.toX(end);
  c.fillStyle = colors.raised;
  c.fillRect(x0, 0, x1 - x0, RULER);
  if (clip) {
    const a = Math.max(-2, view.toX(clip.from)), b = Math.min(view.width + 2, view.toX(clip.to));
    c.fillStyle = clip.hue;
    c.globalAlpha = 0.5;
    c.beginPath();
    c.roundRect(Math.min(a, b), RULER - 3, Math.max(3, Math.abs(b - a)), 2, 1);
    c.fill();
    c.globalAlpha = 1;
  }
  if (span) {
    c.fillStyle = colors.accent;
    c.globalAlpha = colors.dark ? 0.34 : 0.26;
    c.fillRect(view.toX(span[0]), 0, view.toX(span[1]) - view.toX(span[0]), RULER - 1);
    c.globalAlpha = 1;
  }
  c.strokeStyle = colors.line;
  c.lineWidth = 1;
  c.beginPath();
  c.moveTo(0, view.top - 0.5);
  c.lineTo(view.width, view.top - 0.5);
  if (view.top > RULER) {
    c.moveTo(0, RULER - 0.5);
    c.lineTo(view.width, RULER - 0.5);
  }
  c.stroke();
  const { label, tick } = frameSteps(view.perSecond / rate);
  const first = Math.ceil((view.left * rate) / tick) * tick, last = view.toTime(view.width) * rate;
  const head = view.toX(time);
  c.font = `10px ${colors.mono}`;
  c.textAlign = "center";
  c.textBaseline = "middle";
  for (let frame = first; frame <= last; frame += tick) {
    const x = Math.round(view.toX(frame / rate)) + 0.5, major = frame % label === 0;
    c.strokeStyle = major ? colors.faint : colors.strong;
    c.globalAlpha = major ? 0.7 : 0.8;
    c.beginPath();
    c.moveTo(x, major ? RULER - 6 : RULER - 4);
    c.lineTo(x, RULER - 1);
    c.stroke();
    c.globalAlpha = 1;
    if (!major || Math.abs(x - head) < 26) continue;
    c.fillStyle = frame / rate < start - 1e-9 || frame / rate > end + 1e-9 ? colors.faint : colors.muted;
    c.globalAlpha = frame / rate < start - 1e-9 || frame / rate > end + 1e-9 ? 0.75 : 1;
    c.fillText(String(frame), x, 10.5);
    c.globalAlpha = 1;
  }
  c.fillStyle = colors.muted;
  for (const [x, side] of [[x0, -1], [x1, 1]] as const) {
    if (x < -6 || x > view.width + 6) continue;
    c.beginPath();
    c.roundRect(side < 0 ? x : x - 4, RULER - 9, 4, 8, 1.5);
    c.fill();
  }
  if (markers.length > 0) drawMarkers(c, view, colors, markers);
}

function drawMarkers(c: Context, view: View, colors: CurveColors, markers: readonly EditMarker[]): void {
  const y = RULER + MARKERS / 2;
  c.font = `10px ${colors.sans}`;
  c.textAlign = "left";
  const placed = markers.map((marker) => ({ marker, x: view.toX(marker.time) })).sort((a, b) => a.x - b.x);
  placed.forEach(({ marker, x }, n) => {
    if (x < -200 || x > view.width + 8) return;
    c.fillStyle = colors.accent;
    c.beginPath();
    c.moveTo(x, y + 5);
    c.lineTo(x - 4, y - 1);
    c.lineTo(x - 4, y - 5);
    c.lineTo(x + 4, y - 5);
    c.lineTo(x + 4, y - 1);
    c.fill();
    const room = Math.min(160, (placed[n + 1]?.x ?? Infinity) - x - 16);
    if (room < 10) return;
    c.fillStyle = colors.muted;
    c.fillText(fitted(c, marker.name, room), x + 8, y + 0.5);
  });
}

export function drawPlayhead(c: Context, view: View, colors: CurveColors, { time, rate, markers }: RulerState): void {
  // where markers are, a hairline through the plot from each
  c.strokeStyle = colors.accent;
  c.globalAlpha = 0.22;
  c.lineWidth = 1;
  c.setLineDash([2, 3]);
  c.beginPath();
  for (const marker of markers) {
    const x = Math.round(view.toX(marker.time)) + 0.5;
    if (x < 0 || x > view.width) continue;
    c.moveTo(x, view.top);
    c.lineTo(x, view.height);
  }
  c.stroke();
  c.setLineDash([]);
  c.globalAlpha = 1;
  const x = view.toX(time);
  if (x < -40 || x > view.width + 40) return;
  const frame = time * rate, whole = Math.abs(frame - Math.round(frame)) < 1e-4;
  const text = whole ? String(Math.round(frame)) : frame.toFixed(1);
  c.fillStyle = colors.accent;
  c.fillRect(x - 0.75, RULER - 5, 1.5, view.height - RULER + 5);
  c.font = `10px ${colors.mono}`;
  const half = Math.max(11, c.measureText(text).width / 2 + 6);
  c.beginPath();
  c.roundRect(x - half, 3, 2 * half, RULER - 8, 4);
  c.fill();
  c.fillStyle = colors.onAccent;
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillText(text, x, 11);
}
