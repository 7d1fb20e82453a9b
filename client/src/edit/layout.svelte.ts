// Sizes, open tabs and habits: remembered from one visit to the next.

import type { KeyMap } from "./commands";
import type { RotationStyle } from "./posing";

export type RightTab = "joint" | "rig" | "operators" | "poses" | "clip";

const KEY = "keypose.edit";
/** In a window that is narrower, panels lie over the stage, one at a time. */
const NARROW = 760;
const LIMITS = { left: [188, 420], right: [248, 460], bottom: [120, 620], layers: [96, 520] } as const;
export type Size = keyof typeof LIMITS;

export class Layout {
  left = $state(innerWidth < 1600 ? 228 : 280);
  right = $state(innerWidth < 1600 ? 284 : 330);
  bottom = $state(innerHeight < 800 ? 252 : 340);
  layers = $state(innerHeight < 1000 ? 138 : 240);
  leftOpen = $state(true);
  rightOpen = $state(true);
  tab = $state<RightTab>("joint");
  keyMap = $state<KeyMap>("blender");
  /** How rotations are keyed that have no channel yet: three angles with handles, or quaternions. */
  rotations = $state<RotationStyle>("euler");
  onlySelected = $state(true);

  constructor() {
    try {
      const stored = JSON.parse(localStorage.getItem(KEY) ?? "{}") as Record<string, unknown>;
      for (const name of Object.keys(this.values()) as (keyof ReturnType<Layout["values"]>)[])
        if (typeof stored[name] === typeof this[name]) (this as Record<string, unknown>)[name] = stored[name];
    } catch {
      // no storage, or not ours: begin as designed
    }
    for (const name of Object.keys(LIMITS) as Size[]) this.resize(name, 0);
    if (innerWidth <= NARROW) this.leftOpen = this.rightOpen = false;
  }

  /** Open or close a panel. */
  toggle(side: "left" | "right"): void {
    this.open(side, side === "left" ? !this.leftOpen : !this.rightOpen);
  }

  open(side: "left" | "right", open = true): void {
    if (open && innerWidth <= NARROW) this.leftOpen = this.rightOpen = false;
    if (side === "left") this.leftOpen = open;
    else this.rightOpen = open;
    // what a small window needs says nothing of a large one
    if (innerWidth > NARROW) this.remember();
  }

  private values() {
    const { left, right, bottom, layers, leftOpen, rightOpen, tab, keyMap, rotations, onlySelected } = this;
    return { left, right, bottom, layers, leftOpen, rightOpen, tab, keyMap, rotations, onlySelected };
  }

  resize(name: Size, change: number): void {
    const [low, high] = LIMITS[name];
    // the stage keeps a part of the window, however small that is
    const room = name === "bottom" ? innerHeight - 44 - 180 : high;
    this[name] = Math.round(Math.max(low, Math.min(high, room, this[name] + change)));
  }

  remember(): void {
    try {
      localStorage.setItem(KEY, JSON.stringify(this.values()));
    } catch {
      // a browser that forbids storage forgets the layout; nothing else depends on it
    }
  }
}

export const layout = new Layout();
