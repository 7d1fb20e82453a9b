// Keyboard shortcuts: one table for the handler and for the help panel.

import type { Player } from "./player.svelte";
import { studio } from "./studio.svelte";

export interface Shortcut {
  keys: string;
  does: string;
  group: string;
  run: (event: KeyboardEvent) => void;
}

export interface WindowCommands {
  open: () => void;
  togglePanel: (side: "left" | "right") => void;
  find: () => void;
}

/** Keys of the transport. */
export function transportShortcuts(player: Player): Shortcut[] {
  const play = (keys: string, does: string, run: Shortcut["run"]): Shortcut => ({ keys, does, group: "Play", run });
  return [
    play("Space", "Play or pause", () => player.toggle()),
    play(",", "One frame back", () => player.step(-1)),
    play(".", "One frame on", () => player.step(1)),
    play("ArrowLeft", "One frame back (Shift: ten)", (e) => player.step(e.shiftKey ? -10 : -1)),
    play("ArrowRight", "One frame on (Shift: ten)", (e) => player.step(e.shiftKey ? 10 : 1)),
    play("Shift+,", "Previous key", () => player.seekKey(-1)),
    play("Shift+.", "Next key", () => player.seekKey(1)),
    play("Home", "To the start", () => player.toStart()),
    play("End", "To the end", () => player.toEnd()),
    play("[", "Range starts here", () => player.setRange(player.time, player.end)),
    play("]", "Range ends here", () => player.setRange(player.start, player.time)),
    play("\\", "Whole range", () => player.resetRange()),
    play("L", "Loop, once, ping-pong", () => player.cycleMode()),
    play("-", "Slower", () => player.stepSpeed(-1)),
    play("=", "Faster", () => player.stepSpeed(1)),
  ];
}

export function shortcuts(window: WindowCommands): Shortcut[] {
  const play = (keys: string, does: string, run: Shortcut["run"]): Shortcut => ({ keys, does, group: "Play", run });
  const look = (keys: string, does: string, run: Shortcut["run"]): Shortcut => ({ keys, does, group: "Look", run });
  const show = (keys: string, does: string, run: Shortcut["run"]): Shortcut => ({ keys, does, group: "Show", run });
  const win = (keys: string, does: string, run: Shortcut["run"]): Shortcut => ({ keys, does, group: "Window", run });
  return [
    ...transportShortcuts(studio),
    play("N", "Next clip (Shift: previous)", (e) => studio.stepClip(e.shiftKey ? -1 : 1)),
    look("F", "Frame everything", () => studio.view.frameAll()),
    look("Shift+F", "Frame the active character", () => studio.view.frameActive()),
    look("5", "Front", () => studio.view.frameAll("front")),
    look("6", "Side", () => studio.view.frameAll("side")),
    look("7", "Top", () => studio.view.frameAll("top")),
    look("8", "Three-quarter", () => studio.view.frameAll("three-quarter")),
    look("R", "Follow the root", () => studio.toggleFollow()),
    look("Escape", "Select nothing", () => studio.select(-1)),
    show("B", "Bones", () => studio.show("bones")),
    show("A", "Joint axes", () => studio.show("axes")),
    show("W", "Weights of the selected joint", () => studio.show("weights")),
    show("G", "Ghosts before and after", () => studio.show("ghosts")),
    show("D", "Floor grid", () => studio.show("grid")),
    show("I", "Statistics", () => (studio.stats = !studio.stats)),
    win("M", "To the play page", () => studio.turnTo("play")),
    win("O", "Open files", window.open),
    win("P", "Save a picture", () => void studio.screenshot()),
    win("T", "Dark or light theme", () => studio.setTheme(studio.theme === "dark" ? "light" : "dark")),
    win("/", "Find", window.find),
    win("1", "Left panel", () => window.togglePanel("left")),
    win("2", "Right panel", () => window.togglePanel("right")),
    win("Ctrl+Z", "Undo", () => studio.history.undo()),
    win("Ctrl+Shift+Z", "Redo", () => studio.history.redo()),
    win("?", "This panel", () => (studio.help = !studio.help)),
  ];
}

/** The spelling of a pressed key in the table above. */
function spelling(event: KeyboardEvent): string[] {
  const key = event.key === " " ? "Space" : event.key.length === 1 ? event.key.toUpperCase() : event.key;
  const ctrl = event.ctrlKey || event.metaKey ? "Ctrl+" : "";
  if (ctrl) return [`${ctrl}${event.shiftKey ? "Shift+" : ""}${key}`];
  // "<" and ">" are what Shift makes of , and . on many keyboards
  const bare = { "<": ",", ">": "." }[key] ?? key;
  return event.shiftKey ? [`Shift+${bare}`, key] : [key, key === "+" ? "=" : key];
}

/** A button that was clicked with the mouse gives the keyboard back, so that the space bar plays. */
export function releaseFocus(event: MouseEvent): void {
  const focused = document.activeElement;
  // what the click has opened keeps the focus that it took
  if (event.detail > 0 && focused instanceof HTMLButtonElement && focused.contains(event.target as Node)) focused.blur();
}

/** Whether a key goes into a field, or moves the slider or presses the button that has the focus. */
export function isTyping(event: KeyboardEvent): boolean {
  const { target } = event;
  if (target instanceof HTMLInputElement) return !["range", "checkbox"].includes(target.type) || /^(Arrow|Home|End|Page| )/.test(event.key);
  return target instanceof HTMLSelectElement || (target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter"));
}

export function handleKey(event: KeyboardEvent, table: Shortcut[]): void {
  const target = event.target as HTMLElement;
  const checks = target instanceof HTMLInputElement && target.type === "checkbox";
  const typing = target instanceof HTMLInputElement && target.type !== "range" && !checks;
  if (typing || target instanceof HTMLSelectElement || event.altKey) {
    if (event.key === "Escape") {
      if (target instanceof HTMLInputElement && target.type === "search" && target.value) {
        target.value = "";
        target.dispatchEvent(new Event("input", { bubbles: true })); // a browser that clears it says nothing
      } else target.blur();
    }
    return;
  }
  if (studio.help) {
    if (event.key === "Escape" || event.key === "?") studio.help = false;
    return;
  }
  // a slider keeps the keys that move it
  if (target instanceof HTMLInputElement && /^(Arrow|Home|End|Page)/.test(event.key)) return;
  // a button or a box reached by keyboard keeps its own keys
  if ((target instanceof HTMLButtonElement && event.key === "Enter") || ((target instanceof HTMLButtonElement || checks) && event.key === " ")) return;
  for (const keys of spelling(event)) {
    const found = table.find((s) => s.keys === keys);
    if (found) {
      event.preventDefault();
      found.run(event);
      return;
    }
  }
}
