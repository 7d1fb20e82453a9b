// Keys of the play page: those that are held to drive, and the table of all others.

import { save } from "../net/download";
import type { Shortcut } from "../shortcuts";
import { studio } from "../studio.svelte";
import type { Direction } from "./driver";
import { play } from "./play.svelte";
import { stageOf } from "./stage-access";

/** Physical keys, so that the hand lies right on every keyboard layout. */
const DIRECTIONS: Record<string, Direction> = {
  KeyW: "forward",
  KeyS: "back",
  KeyA: "left",
  KeyD: "right",
  ArrowUp: "forward",
  ArrowDown: "back",
  ArrowLeft: "left",
  ArrowRight: "right",
};

function actionOf(event: KeyboardEvent): number {
  const actions = play.playing?.roles.actions ?? [];
  const name = event.code === "Space" ? "Space" : event.code === "KeyE" ? "E" : /^Digit[1-9]$/.test(event.code) ? event.code.slice(5) : "";
  return name ? actions.findIndex((a) => a.keys.includes(name)) : -1;
}

/** A key that drives went down or up; whether it was one. */
export function driveKey(event: KeyboardEvent, down: boolean): boolean {
  const { playing } = play;
  if (!playing || event.ctrlKey || event.metaKey || event.altKey) return false;
  const { driver } = playing;
  if (event.key === "Shift") {
    driver.running = down;
    play.nudge(event.timeStamp);
    return true;
  }
  const direction = DIRECTIONS[event.code];
  if (direction) {
    if (down) driver.held.add(direction);
    else driver.held.delete(direction);
    driver.running = event.shiftKey;
    play.nudge(event.timeStamp);
    return true;
  }
  const action = actionOf(event);
  if (action < 0) return false;
  if (!event.repeat) play.action(action, down, event.timeStamp);
  return true;
}

export async function savePicture(): Promise<void> {
  const stage = stageOf();
  if (stage) save(await stage.screenshot(), `play-${(play.frame?.data.time_s ?? 0).toFixed(2)}s.png`);
}

export interface PlayWindow {
  open: () => void;
  togglePanel: (side: "left" | "right") => void;
  toggleHints: () => void;
}

export function playShortcuts(window: PlayWindow): Shortcut[] {
  const group = (name: string) => (keys: string, does: string, run: Shortcut["run"]): Shortcut => ({ keys, does, group: name, run });
  const drive = group("Drive"), time = group("Time"), look = group("Look"), win = group("Window");
  const nothing = () => {};
  return [
    drive("W", "Go (also arrow keys, left stick)", nothing),
    drive("A", "Left", nothing),
    drive("S", "Back", nothing),
    drive("D", "Right", nothing),
    drive("Shift+W", "Run", nothing),
    drive("Space", "First trigger: jump", nothing),
    drive("E", "First switch: wave (also 1 to 9)", nothing),
    drive("K", "Steer by the camera or by the character", () => play.setSteering(play.steering === "camera" ? "character" : "camera")),
    drive("L", "Look: ahead, at the pointer, at the camera", () => play.cycleLook()),
    time("P", "Pause", () => play.togglePause()),
    time(".", "One step", () => play.step()),
    time("-", "Slower", () => play.stepSpeed(-1)),
    time("=", "Faster", () => play.stepSpeed(1)),
    time("R", "Record, or stop and bake", () => play.toggleRecording()),
    time("Backspace", "Back to the beginning", () => play.reset()),
    look("F", "Follow the character", () => (play.follow = !play.follow)),
    look("C", "Stand behind the character", () => stageOf()?.view.center(play.frame?.data.root[2] ?? 0)),
    look("B", "Bones", () => (play.bones = !play.bones)),
    look("G", "Footprints", () => (play.prints = !play.prints)),
    look("Escape", "Explain no joint", () => play.explain(-1)),
    win("M", "To the view page", () => studio.turnTo("view")),
    win("O", "Open a graph", window.open),
    win("V", "Save a picture", () => void savePicture()),
    win("H", "Key hints", window.toggleHints),
    win("[", "Left panel", () => window.togglePanel("left")),
    win("]", "Right panel", () => window.togglePanel("right")),
    win("T", "Dark or light theme", () => studio.setTheme(studio.theme === "dark" ? "light" : "dark")),
    win("I", "Statistics", () => (studio.stats = !studio.stats)),
    win("?", "This panel", () => (studio.help = !studio.help)),
  ];
}
