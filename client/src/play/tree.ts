// The graph's tree: who hangs on whom, and where each node is drawn.

import type { PlayNode, PlayReady } from "../generated/messages";

export interface TreeNode {
  readonly index: number;
  readonly data: PlayNode;
  readonly children: number[];
  readonly depth: number;
  /** Row of `PlayFrame.machines`, or -1. */
  readonly machine: number;
  /** Of a state: which one, counted in its machine; else -1. */
  readonly state: number;
  /** Middle of the box, in units of the layout, and where it glides to. */
  x: number;
  y: number;
  toX: number;
  toY: number;
  placed: boolean;
  /** Whether it is drawn, and how many of its children are not. */
  shown: boolean;
  folded: number;
}

export const BOX = { width: 80, height: 31, gapX: 8, gapY: 19 } as const;

export class Tree {
  readonly nodes: TreeNode[] = [];
  width: number;
  height: number;
  readonly machines: TreeNode[] = [];

  constructor(readonly ready: PlayReady) {
    ready.nodes.forEach((data, index) => {
      const parent = this.nodes[data.parent];
      const machine = data.kind === "state_machine" ? this.machines.length : -1;
      const node: TreeNode = {
        index,
        data,
        children: [],
        depth: parent ? parent.depth + 1 : 0,
        machine,
        state: parent && parent.machine >= 0 ? parent.data.states.indexOf(data.slot) : -1,
        x: 0,
        y: 0,
        toX: 0,
        toY: 0,
        placed: false,
        shown: true,
        folded: 0,
      };
      parent?.children.push(index);
      this.nodes.push(node);
      if (machine >= 0) this.machines.push(node);
    });
    [this.width, this.height] = layOut(this.nodes);
    this.glide(1);
  }

  /** How much of the output a node gives, from the shares of the nodes above it. */
  reach(shares: Float32Array, out: Float32Array): void {
    for (let n = 0; n < this.nodes.length; n++) {
      const { parent } = this.nodes[n].data;
      out[n] = shares[n] * (parent < 0 ? 1 : out[parent]);
    }
  }

  /** Show these nodes only (with all above them); the others are folded into their parents. */
  fold(shown: readonly boolean[]): void {
    this.nodes.forEach((node, n) => (node.shown = shown[n]));
    for (const node of this.nodes) node.folded = node.shown ? node.children.filter((child) => !shown[child]).length : 0;
    [this.width, this.height] = layOut(this.nodes);
  }

  /** Let the boxes glide to their places. */
  glide(share: number): void {
    for (const node of this.nodes) {
      const moved = node.placed ? share : 1;
      node.x += moved * (node.toX - node.x);
      node.y += moved * (node.toY - node.y);
      node.placed = node.shown;
    }
  }

  /** The node of a state of a machine. */
  stateNode(machine: TreeNode, state: number): TreeNode | undefined {
    return machine.children.map((child) => this.nodes[child]).find((child) => child.state === state);
  }
}

/**
 * A tidy tree from the top down: parents in the middle over their children, subtrees as near to each other as their
 * outlines allow (after Reingold and Tilford, "Tidier Drawings of Trees", 1981). Returns width and height.
 */
function layOut(nodes: TreeNode[]): [number, number] {
  const step = BOX.width + BOX.gapX;
  const offsets = new Float64Array(nodes.length);
  /** Left and right outline of a subtree by depth, seen from its top node. */
  function place(index: number): [number, number][] {
    const children = nodes[index].children.filter((child) => nodes[child].shown);
    if (children.length === 0) return [[0, 0]];
    const outlines = children.map(place);
    const merged: [number, number][] = [];
    const at: number[] = [];
    outlines.forEach((outline, n) => {
      let shift = n === 0 ? 0 : -Infinity;
      if (n > 0) for (let d = 0; d < Math.min(outline.length, merged.length); d++) shift = Math.max(shift, merged[d][1] + step - outline[d][0]);
      at.push(shift);
      outline.forEach(([low, high], d) => {
        if (d < merged.length) merged[d][1] = high + shift;
        else merged.push([low + shift, high + shift]);
      });
    });
    const middle = (at[0] + at[at.length - 1]) / 2;
    children.forEach((child, n) => (offsets[child] = at[n] - middle));
    return [[0, 0], ...merged.map(([low, high]): [number, number] => [low - middle, high - middle])];
  }
  place(0);
  let left = Infinity, right = -Infinity, bottom = 0;
  for (const node of nodes) {
    if (!node.shown) continue;
    node.toX = offsets[node.index] + (node.data.parent < 0 ? 0 : nodes[node.data.parent].toX);
    node.toY = node.depth * (BOX.height + BOX.gapY) + BOX.height / 2;
    left = Math.min(left, node.toX - BOX.width / 2);
    right = Math.max(right, node.toX + BOX.width / 2);
    bottom = Math.max(bottom, node.toY + BOX.height / 2);
  }
  for (const node of nodes) node.toX -= left;
  return [right - left, bottom];
}
