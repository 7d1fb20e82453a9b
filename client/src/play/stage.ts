// The stage of the play page: it draws the newest step of the graph, drives it, and says when it was drawn.

import * as THREE from "three";
import type { Actor } from "../view/actor";
import { NO_MARKS } from "../view/bones";
import { Ground } from "../view/ground";
import { Lights } from "../view/lights";
import { PALETTES, type Theme } from "../view/palette";
import { backdrop, type FrameStats } from "../view/viewport";
import { FollowCamera } from "./follow-camera";
import { Footprints } from "./footprints";
import type { Frame } from "./frame";
import { play, type Playing } from "./play.svelte";

const SAMPLES = 120;
const GROUND_SIZE = 5; // of the grid that fades, in the units of Ground.fit: 22 m around a person
const PAD_ORBIT = 2.4; // radians per second

export class PlayStage {
  readonly view = new FollowCamera();
  /** Called in every frame that changed. */
  readonly painters = new Set<() => void>();
  /** Called in turn, one per frame, so that no frame pays for all of them. */
  readonly slowPainters = new Set<() => void>();
  /** Where the pointer is on the canvas, -1 to 1, for a look that follows it. */
  readonly pointer = new THREE.Vector2(0, 0.1);
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly overlay = new THREE.Scene();
  private readonly ground = new Ground();
  private readonly lights: Lights;
  private readonly prints = new Footprints();
  private playing: Playing | null = null;
  private shown: Frame | null = null;
  private touching: boolean[] = [];
  private theme: Theme = "dark";
  private handle = 0;
  private last = 0;
  private dirty = true;
  private quality = 1;
  private slow = 0;
  private size: [number, number] = [0, 0];
  private tall = 1.8;
  private turnOf = 0;
  private readonly hips = new THREE.Vector3();
  private readonly point = new THREE.Vector3();
  private readonly scriptTimes = new Float64Array(SAMPLES);
  private readonly submitTimes = new Float64Array(SAMPLES);
  private readonly frameTimes = new Float64Array(SAMPLES);
  private samples = 0;
  /** Speed over the ground as it is shown, smoothed. */
  groundSpeed = 0;

  constructor(readonly canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.autoClear = false;
    this.renderer.info.autoReset = false;
    this.lights = new Lights(this.scene, this.renderer);
    this.scene.add(this.ground.mesh, this.prints.mesh);
    const lamp = new THREE.DirectionalLight(0xffffff, 2.2);
    lamp.position.set(0.4, 1, 0.8);
    this.overlay.add(new THREE.HemisphereLight(0xffffff, 0x8890a0, 1.5), lamp);
    this.setTheme("dark");
  }

  /** Draw frames, or stop to: a stage that does not draw lets the graph stand. */
  run(on: boolean): void {
    cancelAnimationFrame(this.handle);
    this.handle = 0;
    if (!on) return;
    this.last = performance.now();
    this.dirty = true;
    this.handle = requestAnimationFrame(this.frame);
  }

  show(playing: Playing | null): void {
    if (this.playing) {
      this.playing.actor.dispose();
      this.playing.file.dispose();
    }
    this.playing = playing;
    this.shown = null;
    this.touching = [];
    this.prints.clear();
    if (playing) {
      this.scene.add(playing.actor.root);
      this.overlay.add(playing.actor.overlay);
      this.frameActor(playing.actor, 0, 0, 0);
      this.paint();
    }
    this.dirty = true;
  }

  private frameActor({ bounds, measuredRoot }: Actor, x: number, z: number, yaw: number): void {
    const size = bounds.getSize(this.point);
    this.tall = Math.max(size.y, 0.6 * size.x, 0.6 * size.z, 1e-3);
    this.view.fit(this.tall, (bounds.min.y + bounds.max.y) / 2, measuredRoot.y, x, z, yaw);
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
    const palette = PALETTES[theme];
    this.ground.paint(palette);
    this.prints.paint(theme === "dark" ? palette.line : palette.shadow, theme === "dark" ? 0.85 : 0.3);
    const previous = this.scene.background;
    this.scene.background = backdrop(palette.backgroundTop, palette.backgroundBottom);
    if (previous instanceof THREE.Texture) previous.dispose();
    this.paint();
  }

  /** Bones and the chosen joint. */
  paint(): void {
    const { playing } = this;
    this.prints.mesh.visible = play.prints;
    this.view.following = play.follow;
    if (playing) {
      playing.actor.showBones(play.bones || play.joint >= 0);
      playing.actor.paint(PALETTES[this.theme], { ...NO_MARKS, active: play.joint });
    }
    this.dirty = true;
  }

  resize(width: number, height: number): void {
    if (width < 2 || height < 2) return;
    this.size = [width, height];
    this.fitCanvas();
    this.draw(); // at once, so that the old picture is not stretched for a frame
  }

  private fitCanvas(): void {
    const [width, height] = this.size;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio) * this.quality);
    this.renderer.setSize(width, height, false);
    this.view.resize(width, height);
    this.dirty = true;
  }

  private setQuality(quality: number): void {
    this.quality = quality;
    this.slow = 0;
    this.fitCanvas();
  }

  /** Where the machine cannot keep up, moving pictures are drawn smaller; as soon as time stands, in full. */
  private adapt(elapsed: number): void {
    this.slow = elapsed > 0.03 ? this.slow + 1 : Math.max(0, this.slow - 2);
    if (this.slow > 10 && this.quality > 0.5) this.setQuality(this.quality - 0.25);
  }

  // ---- the loop ----------------------------------------------------------------------------------------------------

  private readonly frame = (now: number): void => {
    this.handle = requestAnimationFrame(this.frame);
    const began = performance.now();
    const elapsed = Math.min(0.25, Math.max(0, (now - this.last) / 1000));
    this.last = now;
    const { playing } = this;
    if (play.paused && this.quality < 1) this.setQuality(1);
    if (!playing) {
      if (this.dirty) this.draw();
      this.dirty = false;
      return;
    }
    this.drive(playing, elapsed);
    const frame = play.frame;
    const fresh = frame !== null && frame !== this.shown;
    if (fresh) {
      this.apply(playing, frame);
      this.dirty = true;
      if (!play.paused) this.adapt(elapsed);
    }
    const root = this.shown?.data.root ?? [0, 0, 0];
    playing.actor.jointPosition(playing.actor.rootJoint, this.hips);
    if (this.view.update(elapsed, this.hips, root[2], this.groundSpeed)) this.dirty = true;
    if (!this.dirty) return;
    this.dirty = false;
    this.paintPanels();
    const scripted = performance.now();
    this.draw();
    if (fresh) play.drawn(frame);
    const n = this.samples++ % SAMPLES;
    this.scriptTimes[n] = scripted - began;
    this.submitTimes[n] = performance.now() - scripted;
    this.frameTimes[n] = now;
  };

  /** Read stick, gamepad and pointer. */
  private drive(playing: Playing, elapsed: number): void {
    const { driver } = playing;
    const root = this.shown?.data.root ?? [0, 0, 0];
    const changed = driver.update(this.view.heading, root[2]);
    if (driver.padName !== play.padName) play.padName = driver.padName;
    const { down, up, pause, reset } = driver.padActions();
    for (const n of down) play.action(n, true);
    for (const n of up) play.action(n, false);
    if (pause) play.togglePause();
    if (reset) play.reset();
    const [ox, oy] = driver.orbit;
    if (ox !== 0 || oy !== 0) this.view.turn(ox * PAD_ORBIT * elapsed, oy * PAD_ORBIT * elapsed);
    if (play.look !== "off" && playing.roles.look) this.lookAlong(playing, changed);
    play.set(changed);
  }

  private readonly ray = new THREE.Raycaster();
  private readonly aim = new THREE.Vector3();

  /** Where the character shall look, in its own space. */
  private lookAlong(playing: Playing, changed: Record<string, number[]>): void {
    const { camera } = this.view;
    const [x, z, yaw] = this.shown?.data.root ?? [0, 0, 0];
    const head = this.point.set(x, 0.9 * playing.actor.height, z);
    if (play.look === "camera") this.aim.copy(camera.position);
    else {
      this.ray.setFromCamera(this.pointer, camera);
      const { origin, direction } = this.ray.ray;
      const away = origin.distanceTo(head);
      // seen from behind it looks ahead into the picture; seen from the front, out of the picture
      const behind = direction.x * Math.sin(yaw) + direction.z * Math.cos(yaw) > -0.25;
      this.aim.copy(origin).addScaledVector(direction, behind ? away + 5 : 0.4 * away);
    }
    const dx = this.aim.x - x, dz = this.aim.z - z, s = Math.sin(yaw), c = Math.cos(yaw);
    const wanted = [c * dx - s * dz, this.aim.y, s * dx + c * dz];
    const name = playing.roles.look!.target, before = play.values.get(name) ?? [0, 0, 0];
    if (Math.hypot(wanted[0] - before[0], wanted[1] - before[1], wanted[2] - before[2]) > 0.02) changed[name] = wanted;
  }

  private apply(playing: Playing, frame: Frame): void {
    const { actor } = playing, { pose, morphs } = frame;
    const { translations, rotations, scales, morphs: weights } = actor.rig.pose;
    for (let joint = 0; joint < actor.rig.count; joint++) {
      const o = 10 * joint, t = 3 * joint, r = 4 * joint;
      translations[t] = pose[o]; translations[t + 1] = pose[o + 1]; translations[t + 2] = pose[o + 2];
      rotations[r] = pose[o + 3]; rotations[r + 1] = pose[o + 4]; rotations[r + 2] = pose[o + 5]; rotations[r + 3] = pose[o + 6];
      scales[t] = pose[o + 7]; scales[t + 1] = pose[o + 8]; scales[t + 2] = pose[o + 9];
    }
    weights.set(morphs);
    actor.showPose();
    const before = this.shown?.data;
    const { root, time_s: time } = frame.data;
    if (before && time < before.time_s - 1e-6) {
      this.prints.clear();
      this.frameActor(actor, root[0], root[1], root[2]);
      this.groundSpeed = 0;
    } else if (before && time > before.time_s) {
      const passed = time - before.time_s;
      const speed = Math.hypot(root[0] - before.root[0], root[1] - before.root[1]) / passed;
      this.groundSpeed += (speed - this.groundSpeed) * (1 - 2 ** (-passed / 0.08));
    }
    this.shown = frame;
    this.stampFeet(playing, frame);
  }

  private stampFeet(playing: Playing, frame: Frame): void {
    const { actor, ready } = playing;
    this.prints.at(frame.data.time_s);
    ready.contacts.forEach(({ joint }, n) => {
      const touches = frame.contacts[n] >= 0.5;
      if (touches && this.touching[n] === false) {
        actor.jointPosition(joint, this.point);
        this.prints.stamp(this.point.x, this.point.z, frame.data.root[2], 0.15 * actor.height, frame.data.time_s);
      }
      this.touching[n] = touches;
    });
  }

  private paintPanels(): void {
    for (const painter of this.painters) painter();
    const slow = [...this.slowPainters];
    if (slow.length > 0) slow[this.turnOf++ % slow.length]();
  }

  private draw(): void {
    const { renderer } = this;
    if (this.size[0] === 0) return;
    const height = this.tall;
    this.point.set(this.hips.x, Math.max(0.5 * height, this.hips.y), this.hips.z);
    this.lights.fit(this.point, 1.25 * height);
    this.ground.fit(this.point, (GROUND_SIZE * height) / 1.8);
    renderer.info.reset();
    renderer.clear();
    renderer.render(this.scene, this.view.camera);
    if (play.bones || play.joint >= 0) {
      renderer.clearDepth();
      renderer.render(this.overlay, this.view.camera);
    }
  }

  stats(): FrameStats {
    const count = Math.min(this.samples, SAMPLES);
    const at = (values: Float64Array, share: number) => values.slice(0, count).sort()[Math.min(count - 1, Math.floor(share * count))] ?? 0;
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

  /** The joint under a point of the canvas, within a few pixels, or -1. */
  pick(x: number, y: number, reach: number): number {
    const { playing } = this;
    if (!playing) return -1;
    const { actor } = playing, { clientWidth: w, clientHeight: h } = this.canvas;
    let best = -1, nearest = reach;
    for (let joint = 0; joint < actor.rig.count; joint++) {
      actor.jointPosition(joint, this.point).project(this.view.camera);
      if (this.point.z > 1) continue;
      const distance = Math.hypot((0.5 + 0.5 * this.point.x) * w - x, (0.5 - 0.5 * this.point.y) * h - y);
      if (distance < nearest) [best, nearest] = [joint, distance];
    }
    return best;
  }

  /** Where a joint is on the canvas, in CSS pixels. */
  project(joint: number): [number, number] {
    this.playing!.actor.jointPosition(joint, this.point).project(this.view.camera);
    return [(0.5 + 0.5 * this.point.x) * this.canvas.clientWidth, (0.5 - 0.5 * this.point.y) * this.canvas.clientHeight];
  }

  screenshot(): Promise<Blob> {
    if (this.quality < 1) this.setQuality(1);
    this.draw();
    return new Promise((resolve, reject) =>
      this.canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the picture could not be made"))), "image/png"),
    );
  }

  dispose(): void {
    this.run(false);
    this.show(null);
    this.prints.dispose();
    this.renderer.dispose();
  }
}
