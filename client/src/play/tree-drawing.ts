// The graph as it plays: boxes for nodes, edges as thick as what flows through them, transitions on their way.

import { fitted, prepare, stateColor, type Colors } from "./colors";
import { TRANSITION_KINDS, type Frame } from "./frame";
import { BOX, type Tree, type TreeNode } from "./tree";

export interface TreeView {
  scale: number;
  x: number;
  y: number;
}

export interface TreeState {
  tree: Tree;
  frame: Frame | null;
  view: TreeView;
  selected: number;
  hovered: number;
}

const KIND_NAMES: Record<string, string> = {
  clip: "clip",
  rest: "rest pose",
  blend_1d: "1D space",
  blend_2d: "2D space",
  blend: "blend",
  additive: "additive",
  layer: "layer",
  state_machine: "states",
  time_warp: "time warp",
  steer: "steer",
  look_at: "look at",
  two_bone: "two-bone IK",
  plant: "plant feet",
};
export const kindName = (kind: string): string => KIND_NAMES[kind] ?? kind;

export const SEEN = 0.002;
/** Smaller than this there is no text. */
export const READABLE = 0.5;

/** The view that shows the whole tree, but never larger than it is meant. */
export function fitTree(tree: Tree, width: number, height: number): TreeView {
  const pad = 10;
  const scale = Math.min(1.25, (width - 2 * pad) / tree.width, (height - 2 * pad) / tree.height);
  return { scale, x: (width - scale * tree.width) / 2, y: Math.max(pad, (height - scale * tree.height) / 2) };
}

let reach = new Float32Array(0);

/** How much of the output each node gives; good until the next call. */
export function reachOf(tree: Tree, frame: Frame | null): Float32Array {
  if (reach.length !== tree.nodes.length) reach = new Float32Array(tree.nodes.length);
  if (frame) tree.reach(frame.shares, reach);
  else reach.fill(0);
  return reach;
}

export function drawTree(canvas: HTMLCanvasElement, width: number, height: number, colors: Colors, state: TreeState): void {
  const c = prepare(canvas, width, height);
  const { tree, frame, view } = state;
  reachOf(tree, frame);
  c.translate(view.x, view.y);
  c.scale(view.scale, view.scale);
  c.lineCap = "round";
  c.textBaseline = "middle";
  for (const node of tree.nodes) if (node.shown && node.data.parent >= 0) edge(c, colors, state, node);
  for (const machine of tree.machines) if (frame) transition(c, colors, tree, frame, machine);
  for (const node of tree.nodes) if (node.shown) box(c, colors, state, node);
}

function edge(c: CanvasRenderingContext2D, colors: Colors, { tree, frame, view: { scale } }: TreeState, node: TreeNode): void {
  const parent = tree.nodes[node.data.parent];
  const x0 = parent.x, y0 = parent.y + BOX.height / 2, x1 = node.x, y1 = node.y - BOX.height / 2;
  const flow = reach[node.index];
  const middle = (y0 + y1) / 2;
  c.beginPath();
  c.moveTo(x0, y0);
  c.bezierCurveTo(x0, middle, x1, middle, x1, y1);
  c.strokeStyle = flow > SEEN ? colors.accent : colors.strong;
  c.globalAlpha = flow > SEEN ? 0.35 + 0.65 * flow : 0.7;
  c.lineWidth = flow > SEEN ? 1 + 3.5 * flow : 1;
  if (flow <= SEEN) c.setLineDash([2, 4]);
  c.stroke();
  c.setLineDash([]);
  c.globalAlpha = 1;
  const mixing = parent.data.kind.startsWith("blend") || (node.data.slot !== "base" && (parent.data.kind === "layer" || parent.data.kind === "additive"));
  if (mixing && frame && scale >= READABLE) {
    const share = frame.shares[node.index];
    c.font = `9px ${colors.mono}`;
    c.textAlign = "center";
    const text = share.toFixed(2), wide = 25;
    c.fillStyle = colors.panel;
    c.globalAlpha = 0.9;
    c.fillRect(x1 - wide / 2, y1 - 14, wide, 11);
    c.globalAlpha = 1;
    c.fillStyle = share > SEEN ? colors.text : colors.faint;
    c.fillText(text, x1, y1 - 8);
  }
}

/** An arc from the state that is left to the one that is entered; the dot is how far it is. */
function transition(c: CanvasRenderingContext2D, colors: Colors, tree: Tree, frame: Frame, machine: TreeNode): void {
  const row = 4 * machine.machine;
  const kind = TRANSITION_KINDS[frame.machines[row + 2]];
  if (!kind) return;
  const to = tree.stateNode(machine, frame.machines[row]), from = tree.stateNode(machine, frame.machines[row + 1]);
  if (!to?.shown || !from?.shown || to === from) return;
  const share = frame.machines[row + 3];
  const y = to.y - BOX.height / 2, lift = 15;
  const point = (u: number): [number, number] => [
    (1 - u) ** 2 * from.x + 2 * u * (1 - u) * ((from.x + to.x) / 2) + u * u * to.x,
    (1 - u) ** 2 * y + 2 * u * (1 - u) * (y - 2 * lift) + u * u * y,
  ];
  c.strokeStyle = c.fillStyle = colors.kinds[kind];
  c.lineWidth = 2;
  c.globalAlpha = 0.9;
  c.setLineDash([4, 3]);
  c.beginPath();
  c.moveTo(from.x, y);
  c.quadraticCurveTo((from.x + to.x) / 2, y - 2 * lift, to.x, y);
  c.stroke();
  c.setLineDash([]);
  c.globalAlpha = 1;
  const [x, dy] = point(share);
  c.beginPath();
  c.arc(x, dy, 4, 0, 7);
  c.fill();
  c.beginPath();
  const side = Math.sign(to.x - from.x);
  c.moveTo(to.x, y);
  c.lineTo(to.x - 7 * side, y - 5);
  c.lineTo(to.x - 2 * side, y - 8);
  c.fill();
}

function box(c: CanvasRenderingContext2D, colors: Colors, { frame, selected, hovered, tree, view: { scale } }: TreeState, node: TreeNode): void {
  const { width: w, height: h } = BOX;
  const x = node.x - w / 2, y = node.y - h / 2;
  const flow = reach[node.index], active = flow > SEEN;
  const parent = tree.nodes[node.data.parent];
  const current = parent !== undefined && parent.machine >= 0 && frame !== null && frame.machines[4 * parent.machine] === node.state;
  c.globalAlpha = active || node.index === selected ? 1 : 0.62;
  c.fillStyle = node.index === hovered ? colors.hover : colors.raised;
  c.beginPath();
  c.roundRect(x, y, w, h, 6);
  c.fill();
  c.save();
  c.clip();
  const phase = frame ? frame.phases[node.index] : -1;
  if (phase >= 0 && active) {
    c.fillStyle = colors.soft;
    c.fillRect(x, y, w * phase, h);
    c.fillStyle = colors.accent;
    c.fillRect(x + w * phase - 0.5, y, 1, h);
  }
  c.fillStyle = colors.strong;
  c.fillRect(x, y + h - 3, w, 3);
  c.fillStyle = colors.accent;
  c.fillRect(x, y + h - 3, w * flow, 3);
  if (parent !== undefined && parent.machine >= 0) {
    c.fillStyle = stateColor(parent.machine, node.state, colors.dark);
    c.fillRect(x, y, 4, h);
  }
  c.restore();
  c.beginPath();
  c.roundRect(x + 0.5, y + 0.5, w - 1, h - 1, 6);
  c.lineWidth = node.index === selected ? 1.8 : 1;
  c.strokeStyle = node.index === selected ? colors.accent : current && active ? colors.text : colors.strong;
  c.stroke();
  if (scale < READABLE) {
    c.globalAlpha = 1;
    return;
  }
  c.textAlign = "center";
  c.font = `600 11.5px ${colors.sans}`;
  c.fillStyle = active ? colors.text : colors.muted;
  c.fillText(fitted(c, node.data.name, w - 13), node.x + 1, y + 10);
  c.font = `9px ${colors.sans}`;
  c.fillStyle = colors.faint;
  c.fillText(node.folded > 0 ? `${kindName(node.data.kind)} +${node.folded}` : kindName(node.data.kind), node.x + 1, y + 21.5);
  c.globalAlpha = 1;
}

export function nodeAt(tree: Tree, view: TreeView, x: number, y: number): number {
  const u = (x - view.x) / view.scale, v = (y - view.y) / view.scale;
  return tree.nodes.findIndex((n) => n.shown && Math.abs(n.x - u) <= BOX.width / 2 && Math.abs(n.y - v) <= BOX.height / 2);
}
