// Keys of the crowd page.

import type { Shortcut } from "../shortcuts";
import { studio } from "../studio.svelte";
import { crowd } from "./crowd.svelte";

export function crowdShortcuts(open: () => void): Shortcut[] {
  const time = (keys: string, does: string, run: () => void): Shortcut => ({ keys, does, group: "Time", run });
  const look = (keys: string, does: string, run: () => void): Shortcut => ({ keys, does, group: "Look", run });
  const win = (keys: string, does: string, run: () => void): Shortcut => ({ keys, does, group: "Window", run });
  const pause = () => crowd.setPace({ paused: !crowd.paused });
  return [
    time("Space", "Pause or go on", pause),
    time("P", "Pause or go on", pause),
    look("G", "Go along with somebody", () => crowd.onFollow(Math.floor(Math.random() * crowd.count))),
    look("F", "Back to all", () => crowd.onFollow(-1)),
    look("L", "Colour by level of detail", () => (crowd.look.byLevel = !crowd.look.byLevel)),
    look("S", "Shadows", () => (crowd.look.shadows = !crowd.look.shadows)),
    look("D", "Floor grid", () => (crowd.look.grid = !crowd.look.grid)),
    look("C", "Slow orbit", () => (crowd.look.orbit = !crowd.look.orbit)),
    win("M", "To the view page", () => studio.turnTo("view")),
    win("O", "Open files", open),
    win("T", "Dark or light theme", () => studio.setTheme(studio.theme === "dark" ? "light" : "dark")),
    win("1", "Settings", () => (crowd.panel = !crowd.panel)),
    win("?", "This panel", () => (studio.help = !studio.help)),
  ];
}
