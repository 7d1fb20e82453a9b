// The last seconds: which states played, how one became the other, events, and feet on the ground. Time runs to the left.

import { fitted, prepare, stateColor, type Colors } from "./colors";
import type { Playing } from "./play.svelte";

export const GUTTER = 84;
const ROW = 17, GAP = 3, EVENTS = 15, FOOT = 6, TOP = 15;

/** How high the strip is for this graph. */
export function stripHeight({ tree, ready }: Playing): number {
  const events = ready.clips.some((clip) => clip.events.length > 0);
  return TOP + tree.machines.length * (ROW + GAP) + (events ? EVENTS + GAP : 0) + ready.contacts.length * (FOOT + GAP) + 5;
}

export function drawStrip(canvas: HTMLCanvasElement, width: number, height: number, colors: Colors, playing: Playing, seconds: number): void {
  const c = prepare(canvas, width, height);
  const { history, tree, ready } = playing;
  const now = history.now, right = width - 10, scale = (right - GUTTER) / seconds;
  const toX = (time: number) => right - (now - time) * scale;
  const from = now - seconds;
  c.textBaseline = "middle";
  ruler(c, colors, from, now, toX, height);
  c.save();
  c.beginPath();
  c.rect(GUTTER, 0, right - GUTTER, height);
  c.clip();
  let y = TOP;
  for (let row = 0; row < tree.machines.length; row++, y += ROW + GAP) bands(c, colors, playing, row, y, from, toX);
  const events = ready.clips.some((clip) => clip.events.length > 0);
  if (events) {
    marks(c, colors, playing, y, from, toX);
    y += EVENTS + GAP;
  }
  history.contacts.forEach((spans) => {
    c.fillStyle = colors.line;
    c.fillRect(GUTTER, y + FOOT / 2 - 0.5, right - GUTTER, 1);
    c.fillStyle = colors.muted;
    for (const span of spans) {
      if (span.to < from) continue;
      const x0 = Math.max(GUTTER - 4, toX(span.from)), x1 = toX(span.to);
      c.beginPath();
      c.roundRect(x0, y, Math.max(2, x1 - x0), FOOT, 3);
      c.fill();
    }
    y += FOOT + GAP;
  });
  c.restore();
  labels(c, colors, playing, events);
  c.fillStyle = colors.accent;
  c.fillRect(right - 0.75, TOP - 6, 1.5, height - TOP + 2);
  c.beginPath();
  c.arc(right, TOP - 6, 3, 0, 7);
  c.fill();
}

/** What is under a point of the strip, in words. */
export function stripText(playing: Playing, width: number, seconds: number, x: number, y: number): string {
  const { history, tree } = playing;
  const right = width - 10, scale = (right - GUTTER) / seconds;
  if (x < GUTTER) return "";
  const time = history.now - (right - x) / scale, near = 7 / scale;
  const row = Math.floor((y - TOP + GAP) / (ROW + GAP));
  const machine = tree.machines[row];
  if (machine) {
    const { states } = machine.data;
    const cut = history.cuts.findLast((c) => c.machine === row && Math.abs(c.time - time) < near);
    if (cut) return `${states[cut.source]} → ${states[cut.target]}: ${cut.duration > 0 ? `${cut.kind}, ${+cut.duration.toFixed(3)} s` : "cut"}${cut.interrupted ? ", breaks another one off" : ""}, at ${cut.time.toFixed(2)} s`;
    const band = history.bands[row].find((b) => b.from <= time && time <= b.to);
    return band ? `${machine.data.name}: ${states[band.state]}, ${(band.to - band.from).toFixed(2)} s` : "";
  }
  const mark = history.marks.findLast((m) => Math.abs(m.time - time) < near);
  return mark ? `${mark.name} of ${mark.clip}, at ${mark.time.toFixed(2)} s` : "";
}

function ruler(c: CanvasRenderingContext2D, colors: Colors, from: number, now: number, toX: (t: number) => number, height: number): void {
  c.font = `9px ${colors.mono}`;
  c.textAlign = "left";
  for (let second = Math.max(0, Math.ceil(from)); second <= now; second++) {
    const x = Math.round(toX(second)) + 0.5;
    if (x < GUTTER) continue;
    c.strokeStyle = colors.line;
    c.lineWidth = 1;
    c.beginPath();
    c.moveTo(x, 3);
    c.lineTo(x, height);
    c.stroke();
    c.fillStyle = colors.faint;
    c.fillText(`${second} s`, x + 3, 7);
  }
}

function bands(c: CanvasRenderingContext2D, colors: Colors, { history, tree }: Playing, row: number, y: number, from: number, toX: (t: number) => number): void {
  const names = tree.machines[row].data.states;
  c.font = `600 10px ${colors.sans}`;
  c.textAlign = "left";
  for (const band of history.bands[row]) {
    if (band.to < from) continue;
    const x0 = toX(band.from), x1 = toX(band.to);
    c.fillStyle = stateColor(row, band.state, colors.dark, colors.dark ? 0.05 : 0.35);
    c.beginPath();
    c.roundRect(x0 + 0.5, y, Math.max(1.5, x1 - x0 - 1), ROW, 4);
    c.fill();
  }
  for (const cut of history.cuts) {
    if (cut.machine !== row || cut.time + cut.duration < from) continue;
    const x0 = toX(cut.time), x1 = toX(Math.min(history.now, cut.time + cut.duration));
    const color = colors.kinds[cut.kind] ?? colors.text;
    if (cut.duration > 0 && x1 > x0) {
      // the wedge: how the old state's part dies out
      c.globalAlpha = 0.5;
      c.fillStyle = stateColor(row, cut.source, colors.dark, colors.dark ? 0.05 : 0.35);
      c.beginPath();
      c.moveTo(x0, y + ROW);
      c.lineTo(x0, y);
      c.lineTo(toX(cut.time + cut.duration), y + ROW);
      c.fill();
      c.globalAlpha = 1;
      c.fillStyle = color;
      c.fillRect(x0, y + ROW - 2, x1 - x0, 2);
    }
    c.fillStyle = c.strokeStyle = color;
    c.lineWidth = 1.3;
    c.beginPath();
    c.moveTo(x0 - 4, y - 3);
    c.lineTo(x0 + 4, y - 3);
    c.lineTo(x0, y + 4);
    c.closePath();
    // hollow where it broke another one off
    if (cut.interrupted) c.stroke();
    else c.fill();
    c.fillRect(x0 - 0.6, y, 1.2, ROW);
  }
  c.fillStyle = colors.dark ? "#ffffff" : "#1b1c20";
  for (const band of history.bands[row]) {
    const start = Math.max(toX(band.from), GUTTER) + 9, room = toX(band.to) - start - 3;
    if (band.to >= from && room > 14) c.fillText(fitted(c, names[band.state], room), start, y + ROW / 2 + 0.5);
  }
}

function marks(c: CanvasRenderingContext2D, colors: Colors, { history }: Playing, y: number, from: number, toX: (t: number) => number): void {
  c.font = `9.5px ${colors.sans}`;
  c.textAlign = "left";
  const middle = y + EVENTS / 2;
  history.marks.forEach((mark, n) => {
    if (mark.time < from - 2) return;
    const x = toX(mark.time), next = history.marks[n + 1];
    c.fillStyle = colors.accent;
    c.beginPath();
    c.moveTo(x, middle - 4.5);
    c.lineTo(x + 4.5, middle);
    c.lineTo(x, middle + 4.5);
    c.lineTo(x - 4.5, middle);
    c.fill();
    const room = next ? toX(next.time) - x - 14 : 120;
    if (room > 14) {
      c.fillStyle = colors.muted;
      c.fillText(fitted(c, mark.name, room), x + 8, middle + 0.5);
    }
  });
}

function labels(c: CanvasRenderingContext2D, colors: Colors, { tree, ready }: Playing, events: boolean): void {
  c.textAlign = "right";
  c.fillStyle = colors.muted;
  c.font = `10px ${colors.sans}`;
  let y = TOP;
  for (const machine of tree.machines) {
    c.fillText(fitted(c, machine.data.name, GUTTER - 20), GUTTER - 8, y + ROW / 2 + 0.5);
    y += ROW + GAP;
  }
  if (events) {
    c.fillText("events", GUTTER - 8, y + EVENTS / 2 + 0.5);
    y += EVENTS + GAP;
  }
  c.font = `9px ${colors.sans}`;
  c.fillStyle = colors.faint;
  for (const contact of ready.contacts) {
    c.fillText(fitted(c, contact.name.replaceAll("_", " "), GUTTER - 20), GUTTER - 8, y + FOOT / 2 + 0.5);
    y += FOOT + GAP;
  }
}
