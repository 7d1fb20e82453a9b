// A blend space: its samples as large as their weight, and where the parameters are.

import { fitted, prepare, type Colors } from "./colors";
import type { Playing } from "./play.svelte";
import type { Frame } from "./frame";
import type { TreeNode } from "./tree";

/** The numbers that a node reads now. */
export function numberOf(playing: Playing, frame: Frame | null, node: TreeNode, field: string): number {
  const number = node.data.numbers.find((n) => n.field === field);
  if (!number) return 0;
  const slot = number.parameter ? playing.slots.get(number.parameter) : undefined;
  return slot === undefined ? number.value : frame ? frame.parameters[slot] : (playing.ready.parameters.find((p) => p.name === number.parameter)?.default[0] ?? 0);
}

export function drawSpace(canvas: HTMLCanvasElement, width: number, height: number, colors: Colors, playing: Playing, frame: Frame | null, node: TreeNode): void {
  const c = prepare(canvas, width, height);
  c.textBaseline = "middle";
  if (node.data.kind === "blend_1d") line(c, width, height, colors, playing, frame, node);
  else plane(c, width, height, colors, playing, frame, node);
}

function line(c: CanvasRenderingContext2D, width: number, height: number, colors: Colors, playing: Playing, frame: Frame | null, node: TreeNode): void {
  const children = node.children.map((n) => playing.tree.nodes[n]);
  const at = numberOf(playing, frame, node, "parameter");
  const name = node.data.numbers.find((n) => n.field === "parameter")?.parameter ?? "";
  const parameter = playing.ready.parameters.find((p) => p.name === name);
  const places = children.map((n) => n.data.at[0]);
  const low = Math.min(...places, parameter?.minimum ?? Infinity, at), high = Math.max(...places, parameter?.maximum ?? -Infinity, at);
  const pad = 30, y = height * 0.56;
  const toX = (v: number) => pad + ((v - low) / Math.max(1e-9, high - low)) * (width - 2 * pad);
  c.strokeStyle = colors.strong;
  c.lineWidth = 2;
  c.lineCap = "round";
  c.beginPath();
  c.moveTo(toX(low), y);
  c.lineTo(toX(high), y);
  c.stroke();
  c.textAlign = "center";
  for (const child of children) {
    const x = toX(child.data.at[0]), share = frame ? frame.shares[child.index] : 0;
    sample(c, colors, x, y, share);
    c.font = `600 10.5px ${colors.sans}`;
    c.fillStyle = share > 0.002 ? colors.text : colors.muted;
    c.fillText(fitted(c, child.data.name, 90), x, y - 22);
    c.font = `9px ${colors.mono}`;
    c.fillStyle = colors.faint;
    c.fillText(share.toFixed(2), x, y + 21);
  }
  dot(c, colors, toX(at), y);
  c.font = `9.5px ${colors.mono}`;
  c.textAlign = "left";
  c.fillStyle = colors.muted;
  c.fillText(`${name || "value"} ${at.toFixed(2)}`, 10, height - 9);
}

function plane(c: CanvasRenderingContext2D, width: number, height: number, colors: Colors, playing: Playing, frame: Frame | null, node: TreeNode): void {
  const children = node.children.map((n) => playing.tree.nodes[n]);
  const x = numberOf(playing, frame, node, "x"), y = numberOf(playing, frame, node, "y");
  const xs = [...children.map((n) => n.data.at[0]), x], ys = [...children.map((n) => n.data.at[1]), y];
  const lowX = Math.min(...xs), highX = Math.max(...xs), lowY = Math.min(...ys), highY = Math.max(...ys);
  const padX = 40, padY = 22;
  const fullX = (width - 2 * padX) / Math.max(1e-9, highX - lowX), fullY = (height - 2 * padY) / Math.max(1e-9, highY - lowY);
  // the plane fills its place, but no axis is stretched to more than three times the other
  const scaleX = Math.min(fullX, 3 * fullY), scaleY = Math.min(fullY, 3 * fullX);
  const toX = (v: number) => width / 2 + (v - (lowX + highX) / 2) * scaleX;
  const toY = (v: number) => height / 2 - (v - (lowY + highY) / 2) * scaleY;
  const place = (n: number): [number, number] => [toX(children[n].data.at[0]), toY(children[n].data.at[1])];
  for (const corners of node.data.triangles) {
    const weight = frame ? corners.reduce((sum, n) => sum + frame.shares[children[n].index], 0) : 0;
    c.beginPath();
    corners.forEach((n) => c.lineTo(...place(n)));
    c.closePath();
    if (weight > 0.9999) {
      c.fillStyle = colors.soft;
      c.fill();
    }
    c.strokeStyle = colors.strong;
    c.lineWidth = 1;
    c.stroke();
  }
  c.textAlign = "center";
  c.font = `9.5px ${colors.sans}`;
  children.forEach((child, n) => {
    const [px, py] = place(n), share = frame ? frame.shares[child.index] : 0;
    sample(c, colors, px, py, share);
    c.fillStyle = share > 0.002 ? colors.text : colors.faint;
    c.fillText(fitted(c, child.data.name, 70), px, py - 15);
  });
  dot(c, colors, toX(x), toY(y));
  const name = (field: string) => node.data.numbers.find((n) => n.field === field)?.parameter || field;
  c.font = `9.5px ${colors.mono}`;
  c.textAlign = "left";
  c.fillStyle = colors.muted;
  c.fillText(`${name("x")} ${x.toFixed(2)}  ${name("y")} ${y.toFixed(2)}`, 10, height - 9);
}

function sample(c: CanvasRenderingContext2D, colors: Colors, x: number, y: number, share: number): void {
  c.beginPath();
  c.arc(x, y, 4 + 7 * Math.sqrt(share), 0, 7);
  c.fillStyle = share > 0.002 ? colors.soft : colors.panel;
  c.fill();
  c.lineWidth = 1.5;
  c.strokeStyle = share > 0.002 ? colors.accent : colors.strong;
  c.stroke();
}

function dot(c: CanvasRenderingContext2D, colors: Colors, x: number, y: number): void {
  c.beginPath();
  c.arc(x, y, 4.5, 0, 7);
  c.fillStyle = colors.accent;
  c.fill();
  c.lineWidth = 2;
  c.strokeStyle = colors.panel;
  c.stroke();
}
