// The hand of the animator on the stage: selecting joints, holding the gizmo, dragging keys of paths.

import * as THREE from "three";
import { studio } from "../../studio.svelte";
import type { Actor } from "../../view/actor";
import { NO_MARKS, type Marks } from "../../view/bones";
import type { Viewport } from "../../view/viewport";
import { channelOf, type Editor } from "../contract";
import { ControlLines } from "../rig/control-lines";
import { rigging } from "../rig/rigging.svelte";
import { Drag, type Outcome } from "./drag";
import { Gizmo, type Handle } from "./gizmo";
import { axesOf, canMove, pivotOf, startOf, type Locals, type Mode } from "./manipulate";
import { MotionPaths } from "./paths";
import { PathDrag } from "./path-drag";
import { CameraSight } from "./sight";
import { IDENTITY } from "./spaces";
import { tools } from "./tools.svelte";

const CLICK_PX = 4;
const BONE_REACH = 10;
const CONTROL_REACH = 9;
const LABELS: Record<Mode, string> = { move: "Move", rotate: "Rotate", scale: "Scale" };

type Held = ReadonlyMap<string, readonly number[]>;

export class StageEditor {
  readonly gizmo = new Gizmo();
  readonly paths: MotionPaths;
  drag: Drag | null = null;
  private pathDrag: PathDrag | null = null;
  /** The outlines of the controls of the rig that is edited. */
  controls: ControlLines | null = null;
  private dragActor: Actor | null = null;
  private heldBefore: Held = new Map();
  private outcome: Outcome | null = null;
  private pressed: { x: number; y: number; more: boolean } | null = null;
  private pointer = { x: 0, y: 0, inside: false };
  private boxStart: { x: number; y: number; more: boolean } | null = null;
  private readonly undo: (() => void)[] = [];
  private readonly place = new THREE.Vector3();
  private readonly kept: { buttons: THREE.MOUSE | null | undefined };

  constructor(
    readonly editor: Editor,
    readonly view: Viewport,
  ) {
    this.paths = new MotionPaths(view);
    view.tools.add(this.paths.group, this.gizmo.guides, this.gizmo.group);
    view.beforeDraw.add(this.prepare);
    const { canvas } = view;
    const on = <K extends keyof WindowEventMap>(target: EventTarget, name: K, run: (event: WindowEventMap[K]) => void) => {
      target.addEventListener(name, run as EventListener, { capture: true });
      this.undo.push(() => target.removeEventListener(name, run as EventListener, { capture: true }));
    };
    on(canvas, "pointerdown", this.down);
    on(window, "pointermove", this.move);
    on(window, "pointerup", this.up);
    on(canvas, "pointerleave", () => {
      this.pointer.inside = false;
      this.hover(null, -1);
    });
    on(canvas, "contextmenu", (event) => {
      if (this.swallowMenu) event.preventDefault();
      this.swallowMenu = false;
    });
    on(window, "keydown", this.key);
    // in the capture phase, what a field loses passes here too
    on(window, "blur", (event) => event.target === window && this.cancel());
    const { controls } = view.orbit;
    this.kept = { buttons: controls.mouseButtons.MIDDLE };
    // as in other animation programs; left drags turn the view too
    controls.mouseButtons.MIDDLE = THREE.MOUSE.ROTATE;
    this.sync();
  }
  private swallowMenu = false;

  dispose(): void {
    this.cancel();
    for (const undo of this.undo) undo();
    this.view.beforeDraw.delete(this.prepare);
    this.gizmo.dispose();
    this.controls?.dispose();
    this.paths.dispose();
    this.view.marks = null;
    this.view.surface = "shaded";
    this.view.orbit.controls.mouseButtons.MIDDLE = this.kept.buttons;
    this.view.canvas.style.cursor = "";
    this.view.applyDisplay();
  }

  /** Joints that tools act on: those of the actor that there is now. */
  get joints(): readonly number[] {
    const count = this.editor.actor?.rig.count ?? 0;
    return this.editor.selectedJoints.filter((j) => j >= 0 && j < count);
  }

  // ---- what is shown ---------------------------------------------------------------------------------------------------

  /** Bring marks and gizmo in line with selection and tools. */
  sync(): void {
    const { editor, view } = this;
    const joints = this.joints;
    const held = new Set<number>();
    for (const key of editor.posed.keys()) held.add(editor.actor?.rig.index(key.split("\u0000")[0]) ?? -1);
    const marks: Marks = { held, selected: new Set(joints), hovered: tools.hovered, active: joints.at(-1) ?? -1 };
    view.marks = editor.actor === null ? NO_MARKS : marks;
    this.syncControls(marks);
    if (!this.drag) this.gizmo.mode = tools.tool === "select" ? null : tools.tool;
    this.gizmo.present = editor.actor !== null && joints.length > 0;
    this.gizmo.setTheme(view.theme);
    view.paintJoints();
  }

  private switches = "";

  private syncControls(marks: Marks): void {
    const { actor } = this.editor, data = rigging.active;
    if (this.controls && (this.controls.actor !== actor || this.controls.data !== data)) {
      this.controls.dispose();
      this.controls = null;
    }
    if (actor && data && !this.controls) {
      this.controls = new ControlLines(actor, data);
      this.view.tools.add(this.controls.lines);
    }
    this.controls?.paint(this.view.theme, marks);
  }

  private readonly prepare = (): void => {
    const { editor, gizmo, view } = this;
    const { actor } = editor, joints = this.joints;
    const shown = studio.page === "edit" || this.always;
    view.tools.visible = shown;
    if (this.controls) {
      this.controls.lines.visible = tools.controls && !view.filming && (actor?.visible ?? false);
      if (this.controls.lines.visible) {
        const { switches } = this.controls;
        if (switches !== this.switches && view.marks) this.controls.paint(view.theme, view.marks);
        this.switches = switches;
        this.controls.write();
      }
    }
    gizmo.present = shown && actor !== null && joints.length > 0 && !studio.playing && !view.filming;
    if (gizmo.present && actor) {
      const now = { rig: actor.rig, pose: actor.rig.pose, world: actor.rig.world };
      const pivot = pivotOf(now, joints, tools.turns);
      actor.toStage(this.place.set(...(pivot as [number, number, number])));
      const axes = this.drag ? this.drag.axes : axesOf(now, joints.at(-1)!, tools.space);
      // while it turns, a joint's own axes turn along only on the gizmo that is held
      gizmo.stand(this.place, axes ?? IDENTITY);
    }
    view.orbit.camera.updateMatrixWorld();
    gizmo.update(view.orbit.camera, view.canvas.clientWidth, view.canvas.clientHeight);
    this.paths.prepare(studio.time, view.filming ? Infinity : undefined);
  };
  /** Show tools though this is not the edit page: for a stage that is nothing else. */
  always = false;

  // ---- selecting -------------------------------------------------------------------------------------------------------

  private local(event: { clientX: number; clientY: number }): { x: number; y: number } {
    const box = this.view.canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  /** The joint at a point of the canvas: a bone that is seen, else the surface. */
  jointAt(x: number, y: number): number {
    const { editor, view } = this;
    const { actor } = editor;
    if (!actor) return -1;
    const control = this.controlAt(x, y);
    if (control >= 0) return control;
    if (view.display.bones || !actor.hasMesh || tools.surface === "none") {
      const hit = view.pick(x, y, BONE_REACH);
      if (hit?.actor === actor) return hit.joint;
    }
    const { origin, direction } = new CameraSight(view, actor).ray(x, y);
    const ray = new THREE.Ray(new THREE.Vector3(...(origin as [number, number, number])), new THREE.Vector3(...(direction as [number, number, number])));
    return actor.pickSurface(ray)?.joint ?? -1;
  }

  /** The control whose outline is at a point of the canvas, or -1. */
  controlAt(x: number, y: number): number {
    const { controls, view } = this;
    if (!controls || !tools.controls) return -1;
    controls.write();
    // the lines lie on the stage already
    return controls.pick(x, y, CONTROL_REACH, (point) => view.projectStage(point))?.joint ?? -1;
  }

  private click(x: number, y: number, more: boolean): void {
    const { editor } = this;
    const joint = this.jointAt(x, y), before = this.joints;
    if (joint < 0) {
      if (!more) editor.selectedJoints = [];
    } else if (!more) editor.selectedJoints = [joint];
    else if (before.at(-1) === joint) editor.selectedJoints = before.filter((j) => j !== joint);
    else editor.selectedJoints = [...before.filter((j) => j !== joint), joint];
  }

  private boxed(more: boolean): void {
    const { editor, view } = this;
    const { box } = tools, { actor } = editor;
    tools.box = null;
    tools.boxArmed = false;
    this.boxStart = null;
    if (!box || !actor) return;
    const inside: number[] = [];
    for (let joint = 0; joint < actor.rig.count; joint++) {
      const [x, y, depth] = view.project(actor, actor.jointPosition(joint, this.place));
      // of a rig, its controls alone
      if (this.controls && tools.controls && joint < actor.rig.jointCount) continue;
      if (depth !== Infinity && x >= box.x && x <= box.x + box.width && y >= box.y && y <= box.y + box.height) inside.push(joint);
    }
    const before = more ? this.joints.filter((j) => !inside.includes(j)) : [];
    editor.selectedJoints = [...before, ...inside];
  }

  private hover(handle: Handle | null, joint: number): void {
    const { gizmo, view } = this;
    if (gizmo.hovered !== handle) {
      gizmo.hovered = handle;
      view.invalidate();
    }
    if (tools.hovered !== joint) {
      tools.hovered = joint;
      this.sync();
    }
    view.canvas.style.cursor = tools.boxArmed ? "crosshair" : handle || this.paths.hovered ? "grab" : "";
  }

  // ---- the pointer -----------------------------------------------------------------------------------------------------

  private get on(): boolean {
    return studio.page === "edit" || this.always;
  }

  private readonly down = (event: PointerEvent): void => {
    if (!this.on) return;
    const { x, y } = this.local(event);
    if (document.activeElement instanceof HTMLElement && document.activeElement !== document.body) document.activeElement.blur();
    if (this.drag?.modal) {
      this.swallowMenu = event.button === 2;
      if (event.button === 0) this.finish();
      else if (event.button === 2) this.cancel();
      return stop(event);
    }
    if (event.button !== 0) return;
    this.pressed = null;
    const take = () => {
      this.view.canvas.setPointerCapture(event.pointerId);
      stop(event);
    };
    if (tools.boxArmed || (event.shiftKey && !event.ctrlKey && !this.overHandle(x, y))) {
      this.boxStart = { x, y, more: event.shiftKey };
      return take();
    }
    const handle = event.altKey ? null : this.gizmo.handleAt(x, y);
    const joints = this.joints;
    if (handle && joints.length > 0 && this.gizmo.mode) {
      // a click on the empty inside of the trackball selects what lies there
      if (handle === "free") this.pressed = { x, y, more: event.shiftKey };
      this.begin(this.gizmo.mode, handle, { x, y });
      return take();
    }
    const key = this.paths.keyAt(x, y);
    if (key && this.editor.actor) {
      this.pathDrag = new PathDrag(this.editor, this.view, this.editor.actor, key, { x, y });
      return take();
    }
    this.pressed = { x, y, more: event.shiftKey };
  };

  private overHandle(x: number, y: number): boolean {
    const handle = this.gizmo.handleAt(x, y);
    return handle !== null && handle !== "free";
  }

  private readonly move = (event: PointerEvent): void => {
    if (!this.on) return;
    const { x, y } = this.local(event);
    this.pointer = { x, y, inside: event.target === this.view.canvas };
    if (this.drag) {
      if (this.pressed && Math.hypot(x - this.pressed.x, y - this.pressed.y) > CLICK_PX) this.pressed = null;
      this.drag.movePointer({ x, y, fine: event.shiftKey, snap: event.ctrlKey || event.metaKey });
      if (!this.pressed) this.apply(false);
      return;
    }
    if (this.pathDrag) {
      tools.text = this.pathDrag.movePointer(x, y);
      return;
    }
    if (this.boxStart) {
      const { x: a, y: b } = this.boxStart;
      tools.box = { x: Math.min(a, x), y: Math.min(b, y), width: Math.abs(x - a), height: Math.abs(y - b) };
      return;
    }
    if (event.buttons !== 0) return;
    if (!this.pointer.inside) return this.hover(null, -1);
    this.paths.hoverAt(x, y);
    const handle = this.gizmo.handleAt(x, y);
    const control = handle && handle !== "free" ? -1 : this.controlAt(x, y);
    if (control >= 0) return this.hover(handle, control);
    const hit = handle && handle !== "free" ? null : this.view.display.bones ? this.view.pick(x, y, BONE_REACH) : null;
    this.hover(handle, hit && hit.actor === this.editor.actor ? hit.joint : -1);
  };

  private readonly up = (event: PointerEvent): void => {
    if (!this.on) return;
    const { x, y } = this.local(event);
    if (this.drag) {
      if (this.drag.modal) return;
      if (this.pressed) {
        this.cancel();
        this.click(x, y, this.pressed.more);
        this.pressed = null;
      } else this.finish();
      return;
    }
    if (this.pathDrag) {
      this.pathDrag.finish();
      this.pathDrag = null;
      tools.text = "";
      return;
    }
    if (this.boxStart) {
      const { x: a, y: b, more } = this.boxStart;
      if (Math.hypot(x - a, y - b) <= CLICK_PX) {
        this.boxStart = null;
        tools.box = null;
        tools.boxArmed = false;
        this.click(x, y, more);
      } else this.boxed(more);
      return;
    }
    if (!this.pressed || event.button !== 0) return;
    const { pressed } = this;
    this.pressed = null;
    if (Math.hypot(x - pressed.x, y - pressed.y) <= CLICK_PX && event.target === this.view.canvas) this.click(x, y, pressed.more);
  };

  // ---- manipulating ----------------------------------------------------------------------------------------------------

  /** Begin with the pointer where it is: by a key (no handle) or by a handle. */
  begin(mode: Mode, handle: Handle | null = null, at = { x: this.pointer.x, y: this.pointer.y }): void {
    const { editor, view } = this;
    const { actor } = editor, joints = this.joints;
    if (!actor || this.pathDrag) return;
    if (joints.length === 0) {
      editor.toast("info", "Nothing is selected", "Click a joint or a part of the body first.");
      return;
    }
    if (this.drag) return this.switchMode(mode);
    if (editor.autoKey && editor.layer?.locked) {
      editor.toast("info", "This layer is locked", `Unlock “${editor.layer.name}” to change its keys.`);
      return;
    }
    studio.pause();
    if (mode === "move" && !joints.some((j) => canMove(actor.rig, j, { space: "global", pivot: "common", detach: tools.detach }))) {
      const name = actor.rig.names[joints.at(-1)!];
      editor.toast("info", `${name} hangs on its parent`, "It can turn. To pull joints off their bones, turn on “Move any joint”.");
      return;
    }
    const held = joints.find((j) => this.controls?.idle(j));
    const own = joints.find((j) => this.controls && tools.controls && j < actor.rig.jointCount && this.controls.data.modules.some((m) => m.joints.includes(actor.rig.names[j])));
    if (held !== undefined) editor.toast("info", `${actor.rig.names[held]} moves nothing now`, "Its limb goes by the other side: Shift+K goes over between FK and IK.");
    else if (own !== undefined) editor.toast("info", `${actor.rig.names[own]} is moved by the rig`, "Pick one of its controls: the outlines around the body.");
    // the pose that is shown, with what was set by hand
    actor.evaluate(studio.time);
    this.heldBefore = editor.posed;
    this.dragActor = actor;
    const start = startOf(actor.rig, actor.rig.pose, actor.rig.world);
    const where = at.x === 0 && at.y === 0 && !handle ? this.centre() : at;
    this.drag = new Drag(start, joints, mode, handle, tools.space, tools.turns, tools.detach, new CameraSight(view, actor), where);
    this.drag.movePointer({ ...where, fine: false, snap: false });
    this.gizmo.mode = mode;
    this.gizmo.active = handle ?? "screen";
    if (handle === null) this.apply(false);
  }

  private centre(): { x: number; y: number } {
    const [x, y] = this.gizmo.centre();
    return { x: x + 60, y };
  }

  private switchMode(mode: Mode): void {
    const { drag } = this;
    if (!drag) return;
    this.restore();
    drag.switchTo(mode);
    this.gizmo.mode = mode;
    this.apply(false);
  }

  private apply(done: boolean): void {
    const { drag, editor, dragActor } = this;
    if (!drag || !dragActor) return;
    this.outcome = drag.result();
    tools.text = this.outcome.text;
    const { bound } = drag;
    this.gizmo.active = drag.handle ?? ((bound.length > 0 ? bound.join("") : "screen") as Handle);
    this.gizmo.showGuides(drag.modal || bound.length === 1 ? bound : []);
    this.gizmo.showSector(this.outcome.sweep);
    editor.pose(valuesOf(dragActor, this.outcome.locals), `${LABELS[drag.mode]} ${nameOf(dragActor, drag.joints)}`, done);
    this.view.invalidate();
  }

  /** End with what is shown now. */
  finish(): void {
    if (!this.drag) return;
    if (!this.drag.begun) return this.cancel();
    this.apply(true);
    this.end();
  }

  /** End as if nothing had been done. */
  cancel(): void {
    if (this.pathDrag) {
      this.pathDrag.cancel();
      this.pathDrag = null;
      tools.text = "";
    }
    tools.box = null;
    tools.boxArmed = false;
    this.boxStart = null;
    if (!this.drag) return;
    this.restore();
    this.end();
  }

  private restore(): void {
    const { editor } = this;
    if (editor.autoKey) editor.preview(null);
    else editor.posed = this.heldBefore;
    this.view.invalidatePose();
  }

  private end(): void {
    this.drag = null;
    this.dragActor = null;
    this.outcome = null;
    this.gizmo.active = null;
    this.gizmo.showGuides([]);
    this.gizmo.showSector(null);
    tools.text = "";
    this.sync();
  }

  // ---- keys while dragging ---------------------------------------------------------------------------------------------

  private readonly key = (event: KeyboardEvent): void => {
    if (!this.on) return;
    if (event.key === "Escape" && (this.pathDrag || this.boxStart || tools.boxArmed)) {
      this.cancel();
      return stop(event);
    }
    const { drag } = this;
    if (!drag || event.key === "Shift" || event.key === "Control" || event.key === "Meta" || event.key === "Alt") return;
    if (event.ctrlKey || event.metaKey) return stop(event);
    const modes: Record<string, Mode> = { g: "move", r: "rotate", s: "scale" };
    const mode = modes[event.key.toLowerCase()];
    if (event.key === "Escape") this.cancel();
    else if (event.key === "Enter") this.finish();
    else if (mode && drag.modal) this.switchMode(mode);
    else if (drag.key(event)) {
      this.pressed = null;
      this.apply(false);
    }
    // whatever it was: nothing else happens while something is held
    stop(event);
  };
}

function stop(event: Event): void {
  event.preventDefault();
  event.stopImmediatePropagation();
}

/** Local values as the editor takes them: by channel. */
export function valuesOf(actor: Actor, locals: Locals): Map<string, readonly number[]> {
  const out = new Map<string, readonly number[]>();
  for (const [joint, local] of locals)
    for (const property of ["translation", "rotation", "scale"] as const) {
      const value = local[property];
      if (value) out.set(channelOf(actor.rig.names[joint], property).key, value);
    }
  return out;
}

export function nameOf(actor: Actor, joints: readonly number[]): string {
  return joints.length === 1 ? actor.rig.names[joints[0]] : `${joints.length} joints`;
}
