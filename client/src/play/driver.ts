// From held keys, a stick or a gamepad to the graph's parameters.

import type { ActionRole, Roles } from "./roles";

export type Direction = "forward" | "back" | "left" | "right";
export type Steering = "camera" | "character";

/** The parts of a gamepad that are read; a test may put one here. */
export interface Pad {
  axes: readonly number[];
  buttons: readonly { pressed: boolean; value: number }[];
}

const DEAD = 0.16;
const HOLD_MS = 400;
const TURN_GAIN = 5; // degrees per second for each degree that the heading is off
const PAD_ACTIONS = [0, 2, 1, 3, 5, 4];
const START = 9, BACK = 8, RUN_TRIGGER = 7;
const PAD_DIRECTIONS: [number, Direction][] = [[12, "forward"], [13, "back"], [14, "left"], [15, "right"]];

export interface Wanted {
  [parameter: string]: number;
}

export class Driver {
  steering: Steering = "camera";
  readonly held = new Set<Direction>();
  running = false;
  /** On-screen stick: right, forward, each -1 to 1. */
  stick: [number, number] = [0, 0];
  /** Stands in for the machine's gamepad. */
  fakePad: Pad | null = null;
  padName = "";
  /** Right stick of the gamepad: how fast the camera turns. */
  orbit: [number, number] = [0, 0];

  private wanted: Wanted = {};
  private readonly pressedAt = new Map<string, number>();
  private padPressed: boolean[] = [];

  constructor(readonly roles: Roles) {}

  private pad(): Pad | null {
    if (this.fakePad) return this.fakePad;
    const found = navigator.getGamepads?.().find((p) => p !== null && p.connected) ?? null;
    this.padName = found?.id ?? "";
    return found;
  }

  /** Direction (right, forward) of length 1 and how far: 0.5 walks, 1 runs. */
  private push(): { x: number; y: number; amount: number } {
    const pad = this.pad();
    const pressed = new Set(this.held);
    if (pad) for (const [button, direction] of PAD_DIRECTIONS) if (pad.buttons[button]?.pressed) pressed.add(direction);
    let x = Number(pressed.has("right")) - Number(pressed.has("left"));
    let y = Number(pressed.has("forward")) - Number(pressed.has("back"));
    if (x !== 0 || y !== 0) {
      const length = Math.hypot(x, y);
      const running = this.running || (pad?.buttons[RUN_TRIGGER]?.value ?? 0) > 0.5;
      return { x: x / length, y: y / length, amount: running ? 1 : 0.5 };
    }
    [x, y] = this.stick;
    if (Math.hypot(x, y) < DEAD && pad) {
      x = pad.axes[0] ?? 0;
      y = -(pad.axes[1] ?? 0);
    }
    const length = Math.hypot(x, y);
    if (length < DEAD) return { x: 0, y: 0, amount: 0 };
    return { x: x / length, y: y / length, amount: Math.min(1, (length - DEAD) / (0.95 - DEAD)) };
  }

  /** What changed since the last call; `view` is where the camera looks, `yaw` where the character goes (radians). */
  update(view: number, yaw: number): Record<string, number[]> {
    this.readOrbit();
    const { x, y, amount } = this.push();
    const { speed, turn, plane } = this.roles;
    const wanted: Wanted = {};
    if (speed) wanted[speed.name] = 0;
    if (turn) wanted[turn.name] = 0;
    if (plane) wanted[plane.x] = wanted[plane.y] = 0;
    if (amount > 0) {
      if (plane) {
        const [left, right, back, front] = plane.reach;
        wanted[plane.x] = amount * (x > 0 ? x * right : -x * left);
        wanted[plane.y] = amount * (y > 0 ? y * front : -y * back);
      }
      const pace = speed ? (amount <= 0.5 ? 2 * amount * speed.walk : speed.walk + (2 * amount - 1) * (speed.run - speed.walk)) : 0;
      if (this.steering === "camera" && turn && !plane) {
        const off = wrap(view + Math.atan2(-x, y) - yaw);
        const degrees = (off * 180) / Math.PI;
        wanted[turn.name] = Math.max(-turn.most, Math.min(turn.most, TURN_GAIN * degrees));
        // who has to turn around slows down for it
        if (speed) wanted[speed.name] = pace * Math.max(0.4, Math.min(1, 1.5 - Math.abs(degrees) / 120));
      } else {
        if (turn && !plane) wanted[turn.name] = -x * turn.most * (0.4 + 0.6 * amount);
        if (speed) wanted[speed.name] = y >= 0 ? pace * Math.min(1, 1.4 * y) : Math.max(speed.back, pace * y);
      }
    }
    const changed: Record<string, number[]> = {};
    for (const [name, value] of Object.entries(wanted)) {
      const before = this.wanted[name] ?? 0;
      if (value === before || (Math.abs(value - before) < 0.004 * Math.abs(before) && value !== 0)) continue;
      changed[name] = [value];
      this.wanted[name] = value;
    }
    return changed;
  }

  private readOrbit(): void {
    const pad = this.pad();
    const clean = (v = 0) => (Math.abs(v) < DEAD ? 0 : v);
    this.orbit = pad ? [clean(pad.axes[2]), clean(pad.axes[3])] : [0, 0];
  }

  /** Buttons of the gamepad that went down since the last call: actions by number, "pause" or "reset". */
  padActions(): { down: number[]; up: number[]; pause: boolean; reset: boolean } {
    const pad = this.pad();
    const now = pad ? pad.buttons.map((b) => b.pressed) : [];
    const before = this.padPressed;
    this.padPressed = now;
    const went = (button: number, down: boolean) => (now[button] ?? false) === down && (before[button] ?? false) !== down;
    return {
      down: PAD_ACTIONS.flatMap((button, n) => (went(button, true) ? [n] : [])),
      up: PAD_ACTIONS.flatMap((button, n) => (went(button, false) ? [n] : [])),
      pause: went(START, true),
      reset: went(BACK, true),
    };
  }

  /** An action begins or ends; a switch that was held only as long as it was wanted goes off again. */
  action(role: ActionRole, down: boolean, current: number): number[] | null {
    if (role.kind === "trigger") return down ? [1] : null;
    const on = Math.abs(current - role.off) > 1e-6;
    if (down) {
      if (this.pressedAt.has(role.name)) return null;
      this.pressedAt.set(role.name, on ? -Infinity : performance.now());
      return [on ? role.off : role.on];
    }
    const since = this.pressedAt.get(role.name);
    this.pressedAt.delete(role.name);
    return since !== undefined && Number.isFinite(since) && performance.now() - since > HOLD_MS ? [role.off] : null;
  }

  /** Let go of everything: the window lost the keyboard. */
  release(): void {
    this.held.clear();
    this.running = false;
    this.stick = [0, 0];
  }

  /** The graph begins anew: what is held now is sent again. */
  forget(): void {
    this.wanted = {};
  }
}

export function wrap(angle: number): number {
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}
