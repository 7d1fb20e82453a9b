// The stage of the crowd: it draws what lies between the newest steps, and says when a step was drawn.

import * as THREE from "three";
import type { CrowdReady } from "../generated/messages";
import type { Container } from "../net/container";
import { OrbitCamera } from "../view/camera";
import { Ground } from "../view/ground";
import { Lights } from "../view/lights";
import { PALETTES, type Theme } from "../view/palette";
import { backdrop } from "../view/viewport";
import { Bodies } from "./bodies";
import type { Population } from "./population";

const SAMPLES = 90;
const LOOK_MS = 120; // between two messages about where the camera is
const FLIGHT_MS = 900;

export interface CrowdLook {
  byLevel: boolean;
  shadows: boolean;
  grid: boolean;
  orbit: boolean;
}

export interface CrowdStats {
  fps: number;
  script: number;
  drawCalls: number;
  triangles: number;
  visible: number;
}

export class CrowdStage {
  readonly orbit: OrbitCamera;
  bodies: Bodies | null = null;
  population: Population | null = null;
  followed = -1;
  /** Called after each picture with the newest step that is in it. */
  onDrawn: (number: number) => void = () => {};
  onLook: (eye: [number, number, number], fov: number) => void = () => {};
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly ground = new Ground();
  private readonly lights: Lights;
  private look: CrowdLook = { byLevel: false, shadows: true, grid: true, orbit: false };
  private theme: Theme = "dark";
  private handle = 0;
  private last = 0;
  private dirty = true;
  private quality = 1;
  private slow = 0;
  private size: [number, number] = [0, 0];
  private told = 0;
  private readonly toldEye = new THREE.Vector3(NaN, 0, 0);
  private readonly point = new THREE.Vector3();
  private readonly center = new THREE.Vector3();
  private flight: { from: THREE.Vector3; offset: THREE.Vector3; toOffset: THREE.Vector3; began: number } | null = null;
  private readonly times = new Float64Array(SAMPLES);
  private readonly scripts = new Float64Array(SAMPLES);
  private samples = 0;

  constructor(readonly canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.info.autoReset = false;
    this.lights = new Lights(this.scene, this.renderer);
    this.scene.add(this.ground.mesh);
    this.orbit = new OrbitCamera(canvas, () => (this.dirty = true));
    this.orbit.controls.maxPolarAngle = 1.54;
    this.orbit.controls.minDistance = 1.2;
    this.orbit.controls.addEventListener("start", () => (this.flight = null));
    this.setTheme("dark");
  }

  run(on: boolean): void {
    cancelAnimationFrame(this.handle);
    this.handle = 0;
    if (!on) return;
    this.last = performance.now();
    this.dirty = true;
    this.handle = requestAnimationFrame(this.frame);
  }

  show(container: Container<CrowdReady> | null, population: Population | null): void {
    if (this.bodies) {
      this.scene.remove(this.bodies.root);
      this.bodies.dispose();
    }
    const before = this.population?.ready;
    this.population = population;
    this.bodies = container && population ? new Bodies(container, population) : null;
    this.followed = -1;
    if (this.bodies && container) {
      this.scene.add(this.bodies.root);
      const { radius_m: radius, height_m: height } = container.header;
      if (!before || Math.abs(before.radius_m - radius) > 0.01 || before.graph !== container.header.graph) this.overview(radius, height, true);
      this.paint();
    }
    this.dirty = true;
  }

  /** The whole place, from a little above the heads of those in front. */
  overview(radius: number, height: number, immediately = false): void {
    this.followed = -1;
    const { camera, target } = this.orbit;
    const away = Math.min(1.12 * radius, 24 * height) + 2.6 * height;
    const offset = new THREE.Vector3(0.42, 0.3, 0.86).normalize().multiplyScalar(away);
    camera.near = 0.05 * height;
    camera.far = 12 * radius + 60 * height;
    camera.updateProjectionMatrix();
    this.orbit.controls.maxDistance = 5 * radius;
    if (immediately) {
      target.set(0, 0.42 * height, 0.08 * radius);
      camera.position.copy(target).add(offset);
      this.orbit.controls.update();
    } else this.fly(new THREE.Vector3(0, 0.42 * height, 0.08 * radius), offset);
    this.dirty = true;
  }

  private readonly flightTo = new THREE.Vector3();
  private fly(to: THREE.Vector3, toOffset: THREE.Vector3): void {
    this.flightTo.copy(to);
    const { camera, target } = this.orbit;
    this.flight = { from: target.clone(), offset: camera.position.clone().sub(target), toOffset, began: performance.now() };
  }

  /** Go along with somebody, or with nobody (-1). */
  follow(character: number): void {
    this.followed = character;
    if (character < 0 || !this.population) return;
    const { height_m: height } = this.population.ready, yaw = this.population.roots[3 * character + 2];
    const angle = yaw + Math.PI - 0.5;
    const offset = new THREE.Vector3(Math.sin(angle), 0.34, Math.cos(angle)).multiplyScalar(2.7 * height);
    this.fly(this.centerOf(character, new THREE.Vector3()), offset);
  }

  private centerOf(character: number, out: THREE.Vector3): THREE.Vector3 {
    const { roots, ready } = this.population!;
    return out.set(roots[3 * character], 0.55 * ready.height_m, roots[3 * character + 1]);
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
    const palette = PALETTES[theme];
    this.ground.paint(palette);
    const previous = this.scene.background;
    this.scene.background = backdrop(palette.backgroundTop, palette.backgroundBottom);
    if (previous instanceof THREE.Texture) previous.dispose();
    this.paint();
  }

  setLook(look: CrowdLook): void {
    this.look = look;
    this.paint();
  }

  private paint(): void {
    const { look, bodies } = this, palette = PALETTES[this.theme];
    this.ground.grid = look.grid;
    this.lights.key.castShadow = look.shadows;
    this.orbit.controls.autoRotate = look.orbit;
    this.orbit.controls.autoRotateSpeed = 0.35;
    if (bodies) {
      bodies.paint(look.byLevel, look.shadows);
      bodies.blobs.color = palette.shadow;
      bodies.shade = (look.shadows ? 0.55 : 0.95) * palette.shadowStrength;
    }
    this.dirty = true;
  }

  resize(width: number, height: number): void {
    if (width < 2 || height < 2) return;
    this.size = [width, height];
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio) * this.quality);
    this.renderer.setSize(width, height, false);
    this.orbit.resize(width, height);
    this.dirty = true;
    this.draw();
  }

  private setQuality(quality: number): void {
    this.quality = quality;
    this.slow = 0;
    this.resize(...this.size);
  }

  /** Where the machine cannot keep up, less is drawn. */
  private adapt(elapsed: number): void {
    this.slow = elapsed > 0.04 ? this.slow + 1 : Math.max(0, this.slow - 2);
    if (this.slow > 12 && this.quality > 0.5) this.setQuality(this.quality - 0.25);
  }

  // ---- the loop ----------------------------------------------------------------------------------------------------

  private readonly frame = (now: number): void => {
    this.handle = requestAnimationFrame(this.frame);
    const began = performance.now(), elapsed = Math.min(0.25, Math.max(0, (now - this.last) / 1000));
    this.last = now;
    const { population } = this;
    const moved = population?.advance(began) ?? false;
    if (moved) {
      this.adapt(elapsed);
      this.dirty = true;
    }
    this.steerCamera(now);
    if (this.orbit.update(now)) this.dirty = true;
    this.tell(now);
    if (!this.dirty) return;
    this.dirty = false;
    this.bodies?.update(this.orbit.camera, this.look.shadows ? 1.0 : 0);
    const scripted = performance.now();
    this.draw();
    const n = this.samples++ % SAMPLES;
    this.times[n] = now;
    this.scripts[n] = scripted - began;
    if (population) this.onDrawn(population.received);
  };

  private steerCamera(now: number): void {
    const { flight, orbit } = this;
    const along = this.followed >= 0 && this.population ? this.centerOf(this.followed, this.point) : null;
    if (flight) {
      const u = Math.min(1, (now - flight.began) / FLIGHT_MS), e = u * u * (3 - 2 * u);
      const goal = along ?? this.flightTo;
      orbit.target.lerpVectors(flight.from, goal, e);
      orbit.camera.position.lerpVectors(flight.offset, flight.toOffset, e).add(orbit.target);
      if (u >= 1) this.flight = null;
      orbit.follow(null);
      this.dirty = true;
    } else orbit.follow(along);
  }

  /** The server chooses levels of detail by where the camera is. */
  private tell(now: number): void {
    const { position, fov } = this.orbit.perspective;
    if (now - this.told < LOOK_MS || position.distanceToSquared(this.toldEye) < 1e-4) return;
    this.told = now;
    this.toldEye.copy(position);
    this.onLook([position.x, position.y, position.z], fov);
  }

  /** Tell it again, to a server that is new. */
  forgetLook(): void {
    this.toldEye.x = NaN;
    this.told = 0;
  }

  private draw(): void {
    if (this.size[0] === 0) return;
    const { renderer, orbit, population } = this;
    const height = population?.ready.height_m ?? 1.8, radius = population?.ready.radius_m ?? 8;
    const distance = orbit.camera.position.distanceTo(orbit.target);
    // shadows where one looks, sharp enough there; in steps, or their edges would swim
    const reach = height * 2 ** Math.round(2 * Math.log2(Math.min(Math.max(0.62 * distance, 2.2 * height), 11 * height) / height)) ** 1;
    const near = this.center.copy(orbit.target).lerp(orbit.camera.position, 0.12);
    this.center.set(Math.round(near.x), 0.5 * height, Math.round(near.z));
    this.lights.fit(this.center, Math.min(reach, 12 * height));
    this.ground.fit(this.point.set(0, 0, 0), (1.6 * radius + 6 * height) / 4.5);
    renderer.info.reset();
    renderer.render(this.scene, orbit.camera);
  }

  // ---- pointing ----------------------------------------------------------------------------------------------------

  /** Who is under a point of the canvas, or -1. */
  pick(x: number, y: number): number {
    const { population } = this;
    if (!population) return -1;
    const { clientWidth: w, clientHeight: h } = this.canvas, camera = this.orbit.perspective;
    let best = -1, nearest = Infinity;
    for (let n = 0; n < population.count; n++) {
      this.centerOf(n, this.point);
      const away = this.point.distanceTo(camera.position);
      this.point.project(camera);
      if (this.point.z > 1) continue;
      const tall = (population.ready.height_m * h) / (2 * Math.tan((camera.fov * Math.PI) / 360) * away);
      const dx = Math.abs((0.5 + 0.5 * this.point.x) * w - x), dy = Math.abs((0.5 - 0.5 * this.point.y) * h - y);
      if (dx < Math.max(6, 0.22 * tall) && dy < Math.max(8, 0.55 * tall) && away < nearest) [best, nearest] = [n, away];
    }
    return best;
  }

  stats(): CrowdStats {
    const count = Math.min(this.samples, SAMPLES), newest = this.times[(this.samples + SAMPLES - 1) % SAMPLES];
    const recent = this.times.subarray(0, count).filter((t) => newest - t < 1000 && performance.now() - newest < 500);
    const scripts = this.scripts.slice(0, count).sort();
    return {
      fps: recent.length > 1 ? ((recent.length - 1) * 1000) / Math.max(1, newest - Math.min(...recent)) : 0,
      script: scripts[Math.floor(count / 2)] ?? 0,
      drawCalls: this.renderer.info.render.calls,
      triangles: this.renderer.info.render.triangles,
      visible: this.bodies?.visible ?? 0,
    };
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
    this.show(null, null);
    this.renderer.dispose();
  }
}
