// One manipulation from its first movement to its end: pointer and keys in, local transforms and a line of text out.

import { move, pivotOf, rotate, scale, axesOf, type Axis, type Locals, type Mode, type Pivot, type Setting, type Space, type Start } from "./manipulate";
import { normalOf, type Handle } from "./gizmo";
import { add, cross, dot, length, scaled, subtract, unit, within, type Basis, type Vec } from "./spaces";

/** How the character's space is seen: rays through the canvas, and places on it. */
export interface Sight {
  /** The ray through a point of the canvas (CSS pixels), in the character's space. */
  ray(x: number, y: number): { origin: Vec; direction: Vec };
  /** Where a place of the character's space is on the canvas. */
  screen(place: Vec): [number, number];
  /** From a place to the eye, a unit vector. */
  toEye(place: Vec): Vec;
  /** The directions right, up and towards the eye of the picture. */
  picture: Basis;
  /** Metres in a CSS pixel at a place. */
  metresPerPixel(place: Vec): number;
}

export type Constraint = "x" | "y" | "z" | "yz" | "zx" | "xy" | null;

export interface Pointer {
  x: number;
  y: number;
  /** A tenth of the movement. */
  fine: boolean;
  /** In steps: 5 degrees, 5 cm, a tenth. */
  snap: boolean;
}

export interface Outcome {
  readonly locals: Locals;
  readonly text: string;
  /** Angle swept about an axis, for the picture of it. */
  readonly sweep: { axis: Vec; from: Vec; angle: number } | null;
}

export const SNAP_DEG = 5;
export const SNAP_M = 0.05;
export const SNAP_FACTOR = 0.1;
const DEG = 180 / Math.PI;
const SPACE_NAMES: Record<Space, string> = { global: "global", local: "local", parent: "parent" };
/** Pixels of a trackball's drag in a radian. */
const TRACKBALL = 110;

/** The digits that are typed while dragging: one text for each number, Tab goes on to the next. */
class Typed {
  private readonly texts = ["", "", ""];
  private at = 0;

  get any(): boolean {
    return this.texts.some((t) => t !== "");
  }

  number(slot: number): number | null {
    const value = Number(this.texts[slot]);
    return this.texts[slot] === "" || this.texts[slot] === "-" || !Number.isFinite(value) ? null : value;
  }

  text(slot: number): string {
    return this.texts[slot];
  }

  isAt(slot: number): boolean {
    return slot === this.at;
  }

  key(key: string, slots: number): boolean {
    const text = this.texts[this.at];
    if (/^\d$/.test(key)) this.texts[this.at] = text + key;
    else if ((key === "." || key === ",") && !text.includes(".")) this.texts[this.at] = `${text}.`;
    else if (key === "-") this.texts[this.at] = text.startsWith("-") ? text.slice(1) : `-${text}`;
    else if (key === "Backspace") this.texts[this.at] = text.slice(0, -1);
    else if (key === "Tab") this.at = (this.at + 1) % slots;
    else return false;
    return true;
  }

  clear(): void {
    this.texts.fill("");
    this.at = 0;
  }
}

export class Drag {
  constraint: Constraint = null;
  space: Space;
  readonly typed = new Typed();
  private virtual: [number, number];
  private last: [number, number];
  private first: [number, number];
  private swept = 0;
  private angleBefore: number | null = null;
  private snap = false;
  readonly pivot: Vec;
  private readonly active: number;
  /** Whether the pointer moves with no button held: a click ends it. */
  readonly modal: boolean;

  constructor(
    private readonly start: Start,
    readonly joints: readonly number[],
    public mode: Mode,
    /** The handle that was taken, or null where a key began it. */
    readonly handle: Handle | null,
    private readonly chosen: Space,
    readonly turns: Pivot,
    private readonly detach: boolean,
    private readonly sight: Sight,
    pointer: { x: number; y: number },
  ) {
    this.modal = handle === null;
    this.space = chosen;
    this.active = joints.at(-1)!;
    this.pivot = pivotOf(start, joints, turns);
    this.first = [pointer.x, pointer.y];
    this.virtual = [pointer.x, pointer.y];
    this.last = [pointer.x, pointer.y];
    if (handle !== null && handle !== "screen" && handle !== "free") this.constraint = handle;
    // on top of the pivot there is no angle and no distance: begin a little beside it
    const [cx, cy] = sight.screen(this.pivot);
    if (this.modal && Math.hypot(pointer.x - cx, pointer.y - cy) < 12) this.first = this.virtual = [cx + 60, cy];
  }

  private get setting(): Setting {
    return { space: this.space, pivot: this.turns, detach: this.detach };
  }

  get axes(): Basis {
    return axesOf(this.start, this.active, this.space);
  }

  /** The axes that the drag is bound to. */
  get bound(): ("x" | "y" | "z")[] {
    return this.constraint ? ([...this.constraint] as ("x" | "y" | "z")[]) : [];
  }

  movePointer({ x, y, fine, snap }: Pointer): void {
    const s = fine ? 0.1 : 1;
    this.virtual = [this.virtual[0] + s * (x - this.last[0]), this.virtual[1] + s * (y - this.last[1])];
    this.last = [x, y];
    this.snap = snap;
    const angle = this.angleNow();
    if (this.angleBefore !== null) {
      const step = angle - this.angleBefore;
      this.swept += step - 2 * Math.PI * Math.round(step / (2 * Math.PI));
    }
    this.angleBefore = angle;
  }

  /** A key while dragging; whether it meant something. */
  key(event: KeyboardEvent): boolean {
    const axis = event.key.toLowerCase();
    if (axis === "x" || axis === "y" || axis === "z") {
      this.constrain(event.shiftKey ? (["yz", "zx", "xy"] as const)["xyz".indexOf(axis)] : axis);
      return true;
    }
    return this.typed.key(event.key, this.slots);
  }

  /** The same axis again: first in the other space, then none. */
  private constrain(wanted: Exclude<Constraint, null>): void {
    const other: Space = this.chosen === "local" ? "global" : "local";
    if (this.mode === "rotate" && wanted.length === 2) wanted = normalOf(wanted as "yz");
    if (this.constraint !== wanted) [this.constraint, this.space] = [wanted, this.chosen];
    else if (this.space === this.chosen) this.space = other;
    else [this.constraint, this.space] = [null, this.chosen];
    this.restart();
  }

  /** Measure from the first place of the pointer anew, where what is measured changed. */
  private restart(): void {
    const kept = this.virtual;
    this.virtual = this.first;
    this.swept = 0;
    this.angleBefore = this.angleNow();
    this.virtual = kept;
    const step = this.angleNow() - this.angleBefore;
    this.swept = step - 2 * Math.PI * Math.round(step / (2 * Math.PI));
    this.angleBefore = this.angleNow();
  }

  /** Whether anything was dragged or typed yet. */
  get begun(): boolean {
    return this.typed.any || Math.hypot(this.virtual[0] - this.first[0], this.virtual[1] - this.first[1]) > 1e-9;
  }

  /** Another mode with the same pointer. */
  switchTo(mode: Mode): void {
    this.mode = mode;
    this.typed.clear();
    if (mode === "rotate" && this.constraint?.length === 2) this.constraint = null;
    this.restart();
  }

  private get slots(): number {
    if (this.mode !== "move") return 1;
    return this.constraint === null ? 3 : this.constraint.length;
  }

  result(): Outcome {
    if (this.mode === "move") return this.moved();
    return this.mode === "rotate" ? this.turned() : this.sized();
  }

  // ---- move ------------------------------------------------------------------------------------------------------------

  private moved(): Outcome {
    const { constraint } = this;
    // a free move is the same for all, whatever axes they have
    const setting: Setting = constraint ? this.setting : { ...this.setting, space: "global" };
    const axes = constraint ? this.axes : axesOf(this.start, this.active, "global");
    const along3: number[] = [0, 0, 0];
    const delta = within(axes, this.dragged(axes));
    const slots = constraint ? [...constraint].map((a) => "xyz".indexOf(a)) : [0, 1, 2];
    slots.forEach((n) => (along3[n] = this.snap ? SNAP_M * Math.round(delta[n] / SNAP_M) : delta[n]));
    if (this.typed.any) slots.forEach((n, slot) => (along3[n] = this.typed.number(slot) ?? 0));
    const amount = along3 as unknown as Vec;
    const shown = slots.map((n, slot) => `${"XYZ"[n]} ${this.shown(slot, amount[n].toFixed(3))}`).join("  ");
    const locals = move(this.start, this.joints, amount, setting);
    const where = constraint ? ` ${SPACE_NAMES[this.space]}` : "";
    return { locals, text: `Move  ${shown} m${where}  ·  ${length(amount).toFixed(3)} m`, sweep: null };
  }

  /** How far the pointer dragged the pivot, within the constraint. */
  private dragged(axes: Basis): Vec {
    const { constraint, pivot, sight } = this;
    if (constraint?.length === 1) {
      const axis = axes["xyz".indexOf(constraint)];
      return scaled(axis, this.alongAxis(axis, this.virtual) - this.alongAxis(axis, this.first));
    }
    let normal = sight.picture[2];
    if (constraint) {
      const own = axes["xyz".indexOf(normalOf(constraint as "yz"))];
      // from its edge a plane shows nothing of itself: drag across the picture, and keep what lies in the plane
      if (Math.abs(dot(own, sight.toEye(pivot))) > 0.06) normal = own;
    }
    const a = this.onPlane(normal, this.first), b = this.onPlane(normal, this.virtual);
    return a && b ? subtract(b, a) : [0, 0, 0];
  }

  private onPlane(normal: Vec, [x, y]: readonly [number, number]): Vec | null {
    const { origin, direction } = this.sight.ray(x, y);
    const slope = dot(direction, normal);
    const t = slope === 0 ? -1 : dot(subtract(this.pivot, origin), normal) / slope;
    // beyond the horizon of the plane
    return Number.isFinite(t) && (t > 0 || Math.abs(slope) > 1e-3) ? add(origin, scaled(direction, t)) : null;
  }

  /** Metres along an axis through the pivot to where the pointer's ray comes nearest to it. */
  private alongAxis(axis: Vec, [x, y]: readonly [number, number]): number {
    const { origin, direction } = this.sight.ray(x, y);
    const across = cross(axis, direction), l = dot(across, across);
    if (l < 0.02) {
      // the axis points at the eye: up and down moves along it
      return -(y - this.first[1]) * this.sight.metresPerPixel(this.pivot);
    }
    return dot(cross(subtract(origin, this.pivot), direction), across) / l;
  }

  // ---- rotate ----------------------------------------------------------------------------------------------------------

  private get turnAxis(): Vec {
    const { constraint } = this;
    return constraint ? this.axes["xyz".indexOf(constraint)] : this.sight.picture[2];
  }

  /** The angle at which the pointer stands around the axis. */
  private angleNow(): number {
    if (this.mode !== "rotate" || this.handle === "free") return 0;
    const axis = this.turnAxis, { sight, pivot } = this;
    const facing = dot(axis, sight.toEye(pivot));
    if (this.handle && this.constraint && Math.abs(facing) < 0.2) {
      // a ring seen from its edge: along its tangent where it was taken
      const [cx, cy] = sight.screen(pivot), m = sight.metresPerPixel(pivot);
      const [ax, ay] = sight.screen(add(pivot, scaled(axis, 40 * m)));
      const l = Math.hypot(ax - cx, ay - cy) || 1;
      const [dx, dy] = [this.virtual[0] - this.first[0], this.virtual[1] - this.first[1]];
      return ((dx * -(ay - cy) + dy * (ax - cx)) / l) / 84;
    }
    if (this.handle && this.constraint) {
      const hit = this.onPlane(axis, this.virtual);
      if (hit) {
        const [u, v] = beside(axis), from = subtract(hit, pivot);
        return Math.atan2(dot(from, v), dot(from, u));
      }
    }
    const [cx, cy] = sight.screen(pivot);
    return Math.atan2(-(this.virtual[1] - cy), this.virtual[0] - cx) * (facing < 0 ? -1 : 1);
  }

  private turned(): Outcome {
    if (this.handle === "free" && !this.constraint && !this.typed.any) return this.rolled();
    let angle = this.swept;
    if (this.snap) angle = (Math.round((angle * DEG) / SNAP_DEG) * SNAP_DEG) / DEG;
    const typed = this.typed.number(0);
    if (this.typed.any) angle = (typed ?? 0) / DEG;
    const axis = this.constraint ? ("xyz".indexOf(this.constraint) as Axis) : this.sight.picture[2];
    const locals = rotate(this.start, this.joints, axis, angle, this.setting);
    const about = this.constraint ? `about ${SPACE_NAMES[this.space]} ${this.constraint.toUpperCase()}` : "about the view";
    return { locals, text: `Rotate  ${this.shown(0, (angle * DEG).toFixed(1))}°  ${about}`, sweep: this.sweep(angle) };
  }

  private sweep(angle: number): Outcome["sweep"] {
    const axis = this.turnAxis;
    const hit = this.handle ? this.onPlane(axis, this.first) : null;
    const from = hit ? subtract(hit, this.pivot) : beside(axis)[0];
    return { axis, from: unit(subtract(from, scaled(axis, dot(from, axis)))), angle };
  }

  /** A trackball: the picture's right and up drag the surface of a ball. */
  private rolled(): Outcome {
    let [dx, dy] = [(this.virtual[0] - this.first[0]) / TRACKBALL, (this.virtual[1] - this.first[1]) / TRACKBALL];
    if (this.snap) [dx, dy] = [dx, dy].map((a) => (Math.round((a * DEG) / SNAP_DEG) * SNAP_DEG) / DEG);
    const [right, up] = this.sight.picture;
    const turn = add(scaled(up, dx), scaled(right, dy)), angle = length(turn);
    const axis: Vec = angle > 1e-12 ? scaled(turn, 1 / angle) : up;
    return { locals: rotate(this.start, this.joints, axis, angle, this.setting), text: `Turn freely  ${(dx * DEG).toFixed(1)}°  ${(dy * DEG).toFixed(1)}°`, sweep: null };
  }

  // ---- scale -----------------------------------------------------------------------------------------------------------

  private sized(): Outcome {
    let factor = this.factor();
    if (this.snap) factor = SNAP_FACTOR * Math.round(factor / SNAP_FACTOR);
    if (this.typed.any) factor = this.typed.number(0) ?? 1;
    // nothing has no size at all: a joint of scale 0 could not be turned or scaled back
    if (Math.abs(factor) < 1e-4) factor = factor < 0 ? -1e-4 : 1e-4;
    const factors = [..."xyz"].map((a) => (!this.constraint || this.constraint.includes(a) ? factor : 1)) as unknown as Vec;
    const locals = scale(this.start, this.joints, factors, this.setting);
    const where = this.constraint ? `${SPACE_NAMES[this.space]} ${this.constraint.toUpperCase()}` : "all axes";
    return { locals, text: `Scale  ${this.shown(0, factor.toFixed(3))}  ${where}`, sweep: null };
  }

  private factor(): number {
    const { constraint, sight, pivot } = this;
    if (this.handle && constraint?.length === 1) {
      const axis = this.axes["xyz".indexOf(constraint)];
      return 1 + (this.alongAxis(axis, this.virtual) - this.alongAxis(axis, this.first)) / (76 * sight.metresPerPixel(pivot));
    }
    if (this.handle) return 1 + (this.virtual[0] - this.first[0] - (this.virtual[1] - this.first[1])) / 120;
    const [cx, cy] = sight.screen(pivot);
    return Math.hypot(this.virtual[0] - cx, this.virtual[1] - cy) / Math.max(1, Math.hypot(this.first[0] - cx, this.first[1] - cy));
  }

  private shown(slot: number, value: string): string {
    if (!this.typed.any) return value;
    const text = this.typed.text(slot);
    return this.typed.isAt(slot) && this.slots >= 1 ? `[${text}|]` : text || "0";
  }
}

/** Two directions at right angles to an axis and to each other, so that (u, v, axis) is right-handed. */
function beside(axis: Vec): [Vec, Vec] {
  const n = Math.abs(axis[0]) < 0.6 ? 0 : Math.abs(axis[1]) < 0.6 ? 1 : 2;
  const other: Vec = n === 0 ? [1, 0, 0] : n === 1 ? [0, 1, 0] : [0, 0, 1];
  const u = unit(cross(axis, other));
  return [u, cross(axis, u)];
}

