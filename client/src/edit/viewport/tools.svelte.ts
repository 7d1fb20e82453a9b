// What the tools of the 3D view are set to. Habits are remembered from one visit to the next.

import type { Surface } from "../../view/actor";
import type { Mode, Pivot, Space } from "./manipulate";

export type Tool = "select" | Mode;
export const TOOLS: readonly Tool[] = ["select", "move", "rotate", "scale"];
export const SPACES: readonly Space[] = ["local", "parent", "global"];

const KEY = "keypose.edit.view";

export class ViewTools {
  tool = $state<Tool>("rotate");
  space = $state<Space>("local");
  turns = $state<Pivot>("individual");
  /** Whether joints that hang on others may be moved away from them. */
  detach = $state(false);
  surface = $state<Surface>("shaded");
  bones = $state(true);
  /** The controls of a rig, and its joints too, which are moved by them. */
  controls = $state(true);
  axes = $state(false);
  /** Paths of joints in time; of the selected ones where none are pinned. */
  paths = $state(false);
  pinned = $state.raw<readonly number[]>([]);
  speedColors = $state(true);
  ghosts = $state(false);
  ghostsBy = $state<"frames" | "keys">("frames");
  ghostCount = $state(2);
  ghostStep = $state(3);
  /** The picture is parallel, not in perspective. */
  parallel = $state(false);
  lookThrough = $state(false);

  /** What is being dragged, in words. */
  text = $state("");
  /** The rectangle that selects, in CSS pixels of the canvas. */
  box = $state.raw<{ x: number; y: number; width: number; height: number } | null>(null);
  /** The next drag selects by a rectangle. */
  boxArmed = $state(false);
  hovered = $state(-1);
  /** Whether the dialog for films is open. */
  playblast = $state(false);

  constructor() {
    try {
      const stored = JSON.parse(localStorage.getItem(KEY) ?? "{}") as Record<string, unknown>;
      for (const name of Object.keys(this.habits()) as (keyof ReturnType<ViewTools["habits"]>)[])
        if (typeof stored[name] === typeof this[name]) (this as Record<string, unknown>)[name] = stored[name];
    } catch {
      // no storage, or not ours: begin as designed
    }
  }

  private habits() {
    const { tool, space, turns, detach, bones, controls, speedColors, ghostsBy, ghostCount, ghostStep } = this;
    return { tool, space, turns, detach, bones, controls, speedColors, ghostsBy, ghostCount, ghostStep };
  }

  remember(): void {
    try {
      localStorage.setItem(KEY, JSON.stringify(this.habits()));
    } catch {
      // a browser that forbids storage forgets the tools; nothing else depends on it
    }
  }
}

export const tools = new ViewTools();
