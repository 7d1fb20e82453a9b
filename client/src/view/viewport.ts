// The stage: renderer, scene, actors, and the loop that draws a frame when something changed.

import * as THREE from "three";
import { Clock } from "../anim/clock";
import type { Actor, Surface } from "./actor";
import { NO_MARKS, type Marks } from "./bones";
import { OrbitCamera, type Camera, type View } from "./camera";
import type { GhostSettings } from "./ghosts";
import { Ground } from "./ground";
import { Lights } from "./lights";
import { PALETTES, type Theme } from "./palette";

export interface Display {
  bones: boolean;
  axes: boolean;
  weights: boolean;
  ghosts: boolean;
  grid: boolean;
  shadows: boolean;
  follow: boolean;
}

export interface FrameStats {
  /** Frames measured. */
  frames: number;
  /** Frames drawn per second, over the last second. */
  fps: number;
  /** Script milliseconds per frame: animation, kinematics, matrices, read-outs. */
  script: number;
  /** The slowest twentieth of the frames starts here. */
  scriptHigh: number;
  /** Milliseconds of three.js' own work to hand the frame to the browser. */
  submit: number;
  drawCalls: number;
  triangles: number;
}

const SAMPLES = 120;

export class Viewport {
  readonly orbit: OrbitCamera;
  readonly actors: Actor[] = [];
  active: Actor | null = null;
  selected = -1;
  hovered = -1;
  /** Joints of the active actor that stand out where an editor chose several; else `selected` and `hovered` do. */
  marks: Marks | null = null;
  /** How the active actor's surface is drawn. */
  surface: Surface = "shaded";
  /** Drawn over everything else: gizmos and paths. */
  readonly tools = new THREE.Scene();
  /** Called before each picture, to bring the tools in line with the camera. */
  readonly beforeDraw = new Set<() => void>();
  display: Display = { bones: false, axes: false, weights: false, ghosts: false, grid: true, shadows: true, follow: false };
  ghostSettings: GhostSettings = { before: 3, after: 3, step: 4 };
  theme: Theme = "dark";
  /** Called inside every frame in which time moved or something else changed. */
  onFrame: (time: number, moved: boolean) => void = () => {};
  /** Called when playing ends by itself. */
  onStop: () => void = () => {};

  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly overlay = new THREE.Scene();
  private readonly ground = new Ground();
  private readonly lights: Lights;
  private dirty = true;
  private posed = false;
  private last = 0;
  private readonly scriptTimes = new Float64Array(SAMPLES);
  private readonly submitTimes = new Float64Array(SAMPLES);
  private readonly frameTimes = new Float64Array(SAMPLES);
  private samples = 0;
  private readonly point = new THREE.Vector3();
  private handle = 0;

  /** `leads`: whether it moves the clock on; of several views that share one, one does. */
  constructor(readonly canvas: HTMLCanvasElement, readonly clock: Clock = new Clock(), private readonly leads = true) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.autoClear = false;
    this.renderer.info.autoReset = false;
    this.lights = new Lights(this.scene, this.renderer);
    this.scene.add(this.ground.mesh);
    const lamp = new THREE.DirectionalLight(0xffffff, 2.2);
    lamp.position.set(0.4, 1, 0.8);
    this.overlay.add(new THREE.HemisphereLight(0xffffff, 0x8890a0, 1.5), lamp);
    this.orbit = new OrbitCamera(canvas, () => this.invalidate());
    this.setTheme("dark");
    this.fitStage();
    this.handle = requestAnimationFrame(this.frame);
  }

  // ---- who is on the stage -----------------------------------------------------------------------------------------

  add(actor: Actor): void {
    this.actors.push(actor);
    this.scene.add(actor.root);
    this.overlay.add(actor.overlay);
    this.arrange();
    this.applyDisplay();
  }

  /** Put these on the stage in place of those that stand there; nobody is disposed of. */
  present(actors: readonly Actor[]): void {
    for (const actor of this.actors) {
      if (actors.includes(actor)) continue;
      actor.root.removeFromParent();
      actor.overlay.removeFromParent();
    }
    for (const actor of actors) {
      if (this.actors.includes(actor)) continue;
      this.scene.add(actor.root);
      this.overlay.add(actor.overlay);
    }
    this.actors.splice(0, this.actors.length, ...actors);
    this.arrange();
    this.applyDisplay();
  }

  remove(actor: Actor): void {
    if (this.actors.includes(actor)) this.actors.splice(this.actors.indexOf(actor), 1);
    if (this.active === actor) this.active = null;
    actor.dispose();
    this.arrange();
    this.invalidate();
  }

  /** Side by side in the order of opening; a single character stays where its file puts it. */
  arrange(): void {
    const alone = this.actors.length === 1;
    const heights = this.actors.map((actor) => actor.height);
    // a fox in centimetres beside a person in metres: shown equally tall, or one of them could not be seen
    const unequal = Math.max(...heights) > 8 * Math.min(...heights);
    const scales = heights.map((height) => (unequal ? heights[0] / height : 1));
    const widths = this.actors.map((actor, n) => scales[n] * Math.max(0.35 * actor.height, actor.bounds.max.x - actor.bounds.min.x));
    const gaps = this.actors.map((actor, n) => 0.3 * actor.height * scales[n]);
    // a crowd stands in rows, the first in front
    const count = this.actors.length;
    const perRow = count <= 6 ? count : Math.ceil(Math.sqrt(2.5 * count));
    const deep = Math.max(...this.actors.map((actor, n) => scales[n] * (actor.bounds.max.z - actor.bounds.min.z + 0.6 * actor.height)));
    for (let first = 0, row = 0; first < count; first += perRow, row++) {
      const members = this.actors.slice(first, first + perRow);
      const wide = members.reduce((sum, _, n) => sum + widths[first + n] + (n > 0 ? gaps[first + n] : 0), 0);
      let x = -0.5 * wide;
      for (let n = first; n < first + members.length; n++) {
        const actor = this.actors[n], scale = scales[n];
        const { min, max } = actor.bounds;
        if (n > first) x += gaps[n];
        if (alone) actor.place(0, 0, 1);
        else actor.place(x + 0.5 * widths[n] - 0.5 * scale * (min.x + max.x), -0.5 * scale * (min.z + max.z) - row * deep, scale);
        x += widths[n];
      }
    }
    this.fitStage();
  }

  /** What should be in view: the visible characters where they are now. */
  box(only: Actor | null = null): THREE.Box3 {
    const box = new THREE.Box3();
    for (const actor of this.actors) {
      if (!actor.visible || (only && actor !== only)) continue;
      const own = actor.bounds.clone();
      // the bounds were measured in the first pose: move them to where the character is now
      const from = actor.measuredRoot, now = actor.jointPosition(actor.rootJoint, this.point);
      own.translate(new THREE.Vector3(now.x - from.x, 0, now.z - from.z));
      box.expandByPoint(actor.toStage(own.min)).expandByPoint(actor.toStage(own.max));
    }
    if (box.isEmpty()) box.set(new THREE.Vector3(-0.8, 0, -0.8), new THREE.Vector3(0.8, 1.8, 0.8));
    return box;
  }

  private fitStage(): void {
    this.stageSize = Math.max(...this.box().getSize(new THREE.Vector3()).toArray());
  }
  private stageSize = 2;

  frameAll(view: View | null = null, immediately = false): void {
    // the more stand side by side, the more from the front
    this.orbit.frame(this.box(), view, immediately, 1 / Math.max(1, this.actors.filter((a) => a.visible).length));
    this.invalidate();
  }

  frameActive(): void {
    this.orbit.frame(this.box(this.active), null);
    this.invalidate();
  }

  // ---- how it looks ------------------------------------------------------------------------------------------------

  setTheme(theme: Theme): void {
    this.theme = theme;
    const palette = PALETTES[theme];
    this.ground.paint(palette);
    const previous = this.scene.background;
    this.scene.background = backdrop(palette.backgroundTop, palette.backgroundBottom);
    if (previous instanceof THREE.Texture) previous.dispose();
    this.applyDisplay();
  }

  /** Bring everything that is drawn over the characters in line with the settings. */
  applyDisplay(): void {
    const { display, actors } = this;
    const palette = PALETTES[this.theme];
    for (const actor of actors) {
      actor.showBones(display.bones);
      actor.showAxes(display.axes);
      actor.showWeights(display.weights ? (actor === this.active ? this.selected : -2) : null);
      actor.showGhosts(display.ghosts && actor.visible ? this.ghostSettings : null, palette);
      actor.paint(palette, this.marksOf(actor));
      actor.showSurface(this.surface);
    }
    this.ground.grid = display.grid;
    this.lights.key.castShadow = display.shadows;
    this.invalidatePose();
  }

  paintJoints(): void {
    const palette = PALETTES[this.theme];
    for (const actor of this.actors) {
      actor.paint(palette, this.marksOf(actor));
      if (this.display.weights) actor.showWeights(actor === this.active ? this.selected : -2);
    }
    this.invalidate();
  }

  private marksOf(actor: Actor): Marks {
    if (actor !== this.active) return NO_MARKS;
    return this.marks ?? { ...NO_MARKS, active: this.selected, hovered: this.hovered };
  }

  resize(width: number, height: number): void {
    if (width < 2 || height < 2) return;
    this.size = [width, height];
    if (this.filming) return;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio) * this.quality);
    this.renderer.setSize(width, height, false);
    this.orbit.resize(width, height);
    this.invalidate();
    this.draw(); // at once, so that the old picture is not stretched for a frame
  }
  private size: [number, number] = [0, 0];

  /** Where the machine cannot keep up, moving pictures are drawn smaller; as soon as time stands, in full. */
  private adapt(elapsed: number): void {
    if (!this.clock.playing) {
      if (this.quality < 1) this.setQuality(1);
      this.slow = 0;
      return;
    }
    this.slow = elapsed > 0.055 ? this.slow + 1 : Math.max(0, this.slow - 2);
    if (this.slow > 10 && this.quality > 0.5) this.setQuality(this.quality - 0.25);
  }
  private quality = 1;
  private slow = 0;

  private setQuality(quality: number): void {
    this.quality = quality;
    this.slow = 0;
    this.resize(...this.size);
  }

  // ---- the loop ----------------------------------------------------------------------------------------------------

  invalidate(): void {
    this.dirty = true;
  }

  /** The pose must be evaluated again, though time may stand. */
  invalidatePose(): void {
    this.posed = false;
    this.dirty = true;
  }

  /** The time an actor shows: its own animation repeats where it is shorter than the one that sets the pace. */
  localTime(actor: Actor): number {
    const { animation } = actor;
    if (!animation || actor === this.active) return this.clock.time;
    const master = this.active?.animation;
    const elapsed = this.clock.time - (master ? master.start : this.clock.start);
    if (animation.duration <= 0) return animation.start;
    if (elapsed <= animation.duration + 1e-9) return animation.start + Math.max(0, elapsed);
    return this.clock.mode === "once" ? animation.end : animation.start + (elapsed % animation.duration);
  }

  pose(): void {
    for (const actor of this.actors) if (actor.visible) actor.update(this.localTime(actor));
    this.posed = true;
  }

  private readonly frame = (now: number): void => {
    this.handle = requestAnimationFrame(this.frame);
    if (this.filming) return;
    const began = performance.now();
    const elapsed = Math.min(0.25, Math.max(0, (now - this.last) / 1000));
    this.last = now;
    const { clock } = this;
    let moved = false;
    if (clock.playing && this.leads) {
      const before = clock.time;
      const goes = clock.advance(elapsed);
      moved = clock.time !== before;
      if (!goes) this.onStop();
    }
    this.adapt(elapsed);
    const posing = moved || !this.posed;
    if (posing) {
      this.pose();
      this.dirty = true;
    }
    this.followActive();
    if (this.orbit.update(now)) this.dirty = true;
    if (!this.dirty) return;
    this.dirty = false;
    this.onFrame(clock.time, posing);
    const scripted = performance.now();
    this.draw();
    const n = this.samples++ % SAMPLES;
    this.scriptTimes[n] = scripted - began;
    this.submitTimes[n] = performance.now() - scripted;
    this.frameTimes[n] = now;
  };

  private followActive(): void {
    const { active } = this;
    if (!this.display.follow || !active) {
      this.orbit.follow(null);
      return;
    }
    this.orbit.follow(active.toStage(active.jointPosition(active.rootJoint, this.point)));
  }

  draw(camera: Camera = this.orbit.camera, bare = false): void {
    const { renderer } = this;
    const center = this.stageCenter();
    this.lights.fit(center, this.stageSize);
    this.ground.fit(center, this.stageSize);
    if (!bare) for (const prepare of this.beforeDraw) prepare();
    renderer.info.reset();
    renderer.clear();
    renderer.render(this.scene, camera);
    if (bare) return;
    if (this.display.bones || this.display.axes) {
      renderer.clearDepth();
      renderer.render(this.overlay, camera);
    }
    if (this.tools.visible && this.tools.children.length > 0) {
      renderer.clearDepth();
      renderer.render(this.tools, camera);
    }
  }

  /** Light and floor follow what walks away. */
  private readonly centerPoint = new THREE.Vector3();
  private stageCenter(): THREE.Vector3 {
    const center = this.centerPoint.set(0, 0, 0);
    let count = 0;
    for (const actor of this.actors) {
      if (!actor.visible) continue;
      center.add(actor.toStage(actor.jointPosition(actor.rootJoint, this.point)));
      count++;
    }
    if (count > 0) center.divideScalar(count);
    else center.set(0, 0.9, 0);
    return center;
  }

  stats(): FrameStats {
    const count = Math.min(this.samples, SAMPLES);
    const at = (values: Float64Array, share: number) =>
      values.slice(0, count).sort()[Math.min(count - 1, Math.floor(share * count))] ?? 0;
    const newest = this.frameTimes[(this.samples + SAMPLES - 1) % SAMPLES];
    const recent = this.frameTimes.subarray(0, count).filter((t) => newest - t < 1000 && performance.now() - newest < 500);
    return {
      frames: count,
      fps: recent.length > 1 ? ((recent.length - 1) * 1000) / Math.max(1, newest - Math.min(...recent)) : 0,
      script: at(this.scriptTimes, 0.5),
      scriptHigh: at(this.scriptTimes, 0.95),
      submit: at(this.submitTimes, 0.5),
      drawCalls: this.renderer.info.render.calls,
      triangles: this.renderer.info.render.triangles,
    };
  }

  resetStats(): void {
    this.samples = 0;
  }

  // ---- pointing ----------------------------------------------------------------------------------------------------

  /** Where a point of an actor's space is on the canvas, in CSS pixels, and how far from the camera. */
  project(actor: Actor, point: THREE.Vector3): [number, number, number] {
    return this.projectStage(actor.toStage(point));
  }

  /** The same for a point of the stage, which becomes something else. */
  projectStage(point: THREE.Vector3): [number, number, number] {
    const { camera } = this.orbit;
    const distance = point.distanceTo(camera.position);
    point.project(camera);
    const { clientWidth: w, clientHeight: h } = this.canvas;
    return [(0.5 + 0.5 * point.x) * w, (0.5 - 0.5 * point.y) * h, point.z > 1 ? Infinity : distance];
  }

  /** The joint under the pointer: the nearest joint or bone on the screen, within a few pixels. */
  pick(x: number, y: number, reach: number): { actor: Actor; joint: number } | null {
    let best: { actor: Actor; joint: number } | null = null;
    let nearest = reach;
    for (const actor of this.actors) {
      if (!actor.visible) continue;
      const screen = new Float64Array(3 * actor.rig.count);
      for (let joint = 0; joint < actor.rig.jointCount; joint++)
        screen.set(this.project(actor, actor.jointPosition(joint, this.point)), 3 * joint);
      const consider = (joint: number, distance: number) => {
        if (distance < nearest) {
          nearest = distance;
          best = { actor, joint };
        }
      };
      for (let joint = 0; joint < actor.rig.jointCount; joint++) {
        const [jx, jy, depth] = screen.subarray(3 * joint, 3 * joint + 3);
        if (depth === Infinity) continue;
        consider(joint, 0.8 * Math.hypot(jx - x, jy - y));
        const parent = actor.rig.parents[joint];
        if (parent < 0 || screen[3 * parent + 2] === Infinity) continue;
        const px = screen[3 * parent], py = screen[3 * parent + 1];
        const length = (jx - px) ** 2 + (jy - py) ** 2;
        const u = length > 0 ? Math.max(0, Math.min(1, ((x - px) * (jx - px) + (y - py) * (jy - py)) / length)) : 0;
        consider(parent, Math.hypot(px + u * (jx - px) - x, py + u * (jy - py) - y) + 1);
      }
    }
    return best;
  }

  /**
   * Draw a picture of so many pixels and hand the canvas to `use`; then the window is as it was, without having shown
   * it. `camera` is another camera than the view's own; `bare` leaves out what is drawn over the characters.
   */
  picture<T>(width: number, height: number, use: (canvas: HTMLCanvasElement) => T, options: { camera?: Camera; bare?: boolean } = {}): T {
    try {
      this.renderer.setPixelRatio(1);
      this.renderer.setSize(width, height, false);
      this.orbit.resize(width, height);
      this.draw(options.camera, options.bare);
      return use(this.canvas);
    } finally {
      this.resize(...this.size);
    }
  }

  /**
   * Take the canvas for a film of so many pixels; until `end`, the loop rests and the window shows what was drawn last.
   * `bare` leaves out bones, ghosts and all that is drawn over the characters.
   */
  film(width: number, height: number, bare: boolean): { draw: () => HTMLCanvasElement; end: () => void } {
    const { display } = this;
    this.clock.playing = false;
    this.filming = true;
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.orbit.resize(width, height);
    if (bare) {
      this.display = { ...display, bones: false, axes: false, weights: false, ghosts: false };
      this.applyDisplay();
    }
    return {
      draw: () => {
        this.pose();
        this.followActive();
        this.onFrame(this.clock.time, true);
        this.draw(undefined, bare);
        return this.canvas;
      },
      end: () => {
        this.filming = false;
        this.display = display;
        this.applyDisplay();
        this.resize(...this.size);
      },
    };
  }
  filming = false;

  screenshot(): Promise<Blob> {
    if (this.quality < 1) this.setQuality(1);
    this.draw();
    return new Promise((resolve, reject) =>
      this.canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the picture could not be made"))), "image/png"),
    );
  }

  dispose(): void {
    cancelAnimationFrame(this.handle);
    this.renderer.dispose();
  }
}

/** A soft vertical gradient with a little noise against banding. */
export function backdrop(top: string, bottom: string): THREE.Texture {
  const canvas = document.createElement("canvas");
  canvas.width = 256;
  canvas.height = 256;
  const context = canvas.getContext("2d")!;
  const gradient = context.createLinearGradient(0, 0, 0, 256);
  gradient.addColorStop(0, top);
  gradient.addColorStop(1, bottom);
  context.fillStyle = gradient;
  context.fillRect(0, 0, 256, 256);
  const pixels = context.getImageData(0, 0, 256, 256);
  let seed = 1;
  for (let i = 0; i < pixels.data.length; i += 4) {
    seed = (seed * 16807) % 2147483647;
    const noise = (seed / 2147483647 - 0.5) * 2.4;
    for (let c = 0; c < 3; c++) pixels.data[i + c] += noise;
  }
  context.putImageData(pixels, 0, 0);
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}
