// Two stages side by side with one clock: the source performs its motion, the target the retargeted one, and what turns one
// camera turns the other.

import * as THREE from "three";
import { Clock } from "../anim/clock";
import type { RetargetFoot } from "../generated/messages";
import type { Actor, Surface } from "../view/actor";
import { NO_MARKS } from "../view/bones";
import type { View } from "../view/camera";
import type { Theme } from "../view/palette";
import { Viewport } from "../view/viewport";
import { Prints } from "./prints";
import { PropMarks } from "./prop-marks";

export const SIDES = ["source", "target"] as const;
export type SideName = (typeof SIDES)[number];

export interface Look {
  bones: boolean;
  surface: Surface;
  grid: boolean;
  follow: boolean;
  prints: boolean;
  linked: boolean;
}

const PRINT_COLORS: Record<Theme, [string, string, number]> = { dark: ["#43c08a", "#ff5a4f", 0.85], light: ["#12855a", "#d3281d", 0.75] };

export class Pair {
  readonly clock = new Clock();
  readonly views: Record<SideName, Viewport>;
  readonly prints: Record<SideName, Prints> = { source: new Prints(), target: new Prints() };
  private readonly props: Record<SideName, PropMarks> = { source: new PropMarks(), target: new PropMarks() };
  /** Called in every frame that changed. */
  onFrame: (time: number, posed: boolean) => void = () => {};
  onStop: () => void = () => {};
  private driver: SideName = "source";
  private look: Look = { bones: false, surface: "shaded", grid: true, follow: false, prints: true, linked: true };
  /** Whose bones are shown in any case: the one whose roles are chosen. */
  private picking: SideName | null = null;
  private readonly a = new THREE.Vector3();
  private readonly b = new THREE.Vector3();
  private readonly offset = new THREE.Vector3();

  constructor(canvases: Record<SideName, HTMLCanvasElement>) {
    this.views = { source: new Viewport(canvases.source, this.clock), target: new Viewport(canvases.target, this.clock, false) };
    const { source, target } = this.views;
    source.onFrame = (time, posed) => {
      if (posed) target.invalidatePose();
      for (const side of SIDES) this.prints[side].at(time);
      this.onFrame(time, posed);
    };
    source.onStop = () => this.onStop();
    for (const side of SIDES) {
      const view = this.views[side];
      view.orbit.controls.addEventListener("start", () => (this.driver = side));
      view.beforeDraw.add(() => this.link(side));
    }
  }

  other(side: SideName): SideName {
    return side === "source" ? "target" : "source";
  }

  actor(side: SideName): Actor | null {
    return this.views[side].actors[0] ?? null;
  }

  show(side: SideName, actor: Actor | null): void {
    const view = this.views[side], prints = this.prints[side];
    prints.group.removeFromParent();
    this.props[side].group.removeFromParent();
    view.present(actor ? [actor] : []);
    view.active = actor;
    actor?.root.add(prints.group, this.props[side].group);
    this.applyLook();
    this.frame("three-quarter", true);
  }

  steps(side: SideName, feet: readonly RetargetFoot[], start: number, rate: number): void {
    const actor = this.actor(side), own = side === "source";
    const shown = feet.map((foot) => ({
      side: foot.role.startsWith("left") ? ("left" as const) : ("right" as const),
      joints: own ? foot.source : foot.target,
      steps: foot.steps,
      slides: own ? foot.source_slides_cm_s : foot.target_slides_cm_s,
    }));
    if (actor) this.prints[side].fit(actor, shown, start, rate);
    this.views[side].invalidate();
  }

  /** Where hands hold on to something: six numbers each, in the source's world and in the target's. */
  showProps(places: readonly (readonly number[])[]): void {
    for (const [n, side] of SIDES.entries()) {
      this.props[side].show(places.map((numbers) => numbers.slice(3 * n, 3 * n + 3)), 0.028 * (this.actor(side)?.height ?? 1.7));
      this.views[side].invalidate();
    }
  }

  // ---- how it looks ------------------------------------------------------------------------------------------------

  setTheme(theme: Theme): void {
    for (const side of SIDES) {
      this.prints[side].paint(...PRINT_COLORS[theme]);
      this.props[side].paint(theme);
      this.views[side].setTheme(theme);
    }
  }

  setLook(look: Look, picking: SideName | null): void {
    this.look = look;
    this.picking = picking;
    this.applyLook();
  }

  private applyLook(): void {
    const { bones, surface, grid, follow, prints } = this.look;
    for (const side of SIDES) {
      const view = this.views[side];
      const skeleton = bones || surface === "none" || this.picking === side;
      view.display = { ...view.display, bones: skeleton, grid, follow: follow && this.picking === null };
      view.surface = surface;
      this.prints[side].group.visible = prints && this.picking !== side;
      this.props[side].group.visible = this.picking !== side;
      if (this.picking !== side) view.marks = NO_MARKS;
      view.applyDisplay();
    }
  }

  /** Joints that stand out on one side: the hovered and the chosen one. */
  mark(side: SideName, hovered: number, active: number): void {
    const view = this.views[side];
    view.marks = { ...NO_MARKS, hovered, active };
    view.paintJoints();
  }

  // ---- cameras -----------------------------------------------------------------------------------------------------

  frame(view: View | null = null, immediately = false): void {
    for (const side of SIDES) {
      const actor = this.actor(side), shown = this.views[side];
      if (!actor) continue;
      // where they stand now, not where they stood in the last picture
      shown.pose();
      shown.orbit.follow(null);
      if (shown.display.follow) shown.orbit.follow(actor.toStage(actor.jointPosition(actor.rootJoint, this.a)));
      shown.frameAll(view, immediately);
    }
    this.driver = this.actor("target") ? "target" : "source";
  }

  /** Where the character stands on the ground, which its camera is counted from. */
  private anchor(side: SideName, out: THREE.Vector3): THREE.Vector3 | null {
    const actor = this.actor(side);
    if (!actor) return null;
    const follows = this.views[side].display.follow;
    const root = follows ? actor.jointPosition(actor.rootJoint, out) : out.copy(actor.measuredRoot);
    return actor.toStage(root).setY(0);
  }

  /** How high a character reaches in what it performs. */
  private tall(side: SideName): number {
    const { min, max } = this.actor(side)!.bounds;
    return Math.max(1e-6, max.y - min.y);
  }

  /** The camera of the side that was turned last, seen from its character, is the other side's too. */
  private link(side: SideName): void {
    if (!this.look.linked || side !== this.driver || this.picking !== null) return;
    const other = this.other(side), from = this.views[side], to = this.views[other];
    const a = this.anchor(side, this.a), b = this.anchor(other, this.b);
    if (!a || !b) return;
    const ratio = this.tall(other) / this.tall(side);
    const place = (out: THREE.Vector3, at: THREE.Vector3) => {
      this.offset.copy(at).sub(a).multiplyScalar(ratio).add(b);
      const moved = out.distanceToSquared(this.offset) > 1e-12;
      out.copy(this.offset);
      return moved;
    };
    const moved = place(to.orbit.target, from.orbit.target);
    if (place(to.orbit.camera.position, from.orbit.camera.position) || moved) {
      to.orbit.controls.update();
      to.invalidate();
    }
  }

  // ---- the rest ----------------------------------------------------------------------------------------------------

  reposed(): void {
    for (const side of SIDES) this.views[side].invalidatePose();
  }

  /** Both pictures beside each other. */
  async screenshot(): Promise<Blob> {
    const images = await Promise.all(SIDES.map(async (side) => createImageBitmap(await this.views[side].screenshot())));
    const canvas = document.createElement("canvas");
    canvas.width = images[0].width + images[1].width + 2;
    canvas.height = Math.max(...images.map((image) => image.height));
    const context = canvas.getContext("2d")!;
    context.drawImage(images[0], 0, 0);
    context.drawImage(images[1], images[0].width + 2, 0);
    for (const image of images) image.close();
    return new Promise((resolve, reject) => canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the picture could not be made"))), "image/png"));
  }

  dispose(): void {
    for (const side of SIDES) {
      this.prints[side].dispose();
      this.props[side].dispose();
      this.views[side].dispose();
    }
  }
}
