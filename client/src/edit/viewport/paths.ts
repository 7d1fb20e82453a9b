// Motion paths: where joints go over the range, with a tick for each frame, larger marks at keys, coloured by speed.
// After an edit the path is measured anew, nearest in time first, a few milliseconds in each frame.

import * as THREE from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import { Pose } from "../../anim/rig";
import type { Actor } from "../../view/actor";
import { PALETTES } from "../../view/palette";
import type { Viewport } from "../../view/viewport";

/** Script time that a frame may spend on measuring. */
const BUDGET_MS = 3;
const GRAB_PX = 9;
const SAME = 2e-5;

/** What a path needs to know of the document: the times of keys, and whether they can be dragged. */
export interface PathKeys {
  readonly times: Float64Array;
  readonly draggable: boolean;
}

export interface PathKey {
  readonly joint: number;
  readonly time: number;
  readonly position: THREE.Vector3;
}

// slow to fast: blue over green and yellow to red, equally bright
const RAMP = [0x3f7fff, 0x1fb5c9, 0x5cc45a, 0xe8c33a, 0xf2803a, 0xf0466a].map((hex) => new THREE.Color(hex));

function ramp(u: number, out: THREE.Color): THREE.Color {
  const x = Math.max(0, Math.min(1, u)) * (RAMP.length - 1), n = Math.min(RAMP.length - 2, Math.floor(x));
  return out.copy(RAMP[n]).lerp(RAMP[n + 1], x - n);
}

class DotMaterial extends THREE.ShaderMaterial {
  constructor() {
    super({
      uniforms: { ratio: { value: 1 } },
      vertexShader: /* glsl */ `
        attribute vec3 color;
        attribute vec2 look; // diameter in pixels; 0 a disc, 1 a rhombus, 2 a ring
        uniform float ratio;
        varying vec3 shade;
        varying float shape;
        varying float pixels;
        void main() {
          shade = color;
          shape = look.y;
          pixels = look.x * ratio;
          gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
          gl_PointSize = pixels + 2.0;
        }`,
      fragmentShader: /* glsl */ `
        varying vec3 shade;
        varying float shape;
        varying float pixels;
        void main() {
          vec2 p = (gl_PointCoord - 0.5) * (pixels + 2.0);
          float away = shape > 0.5 && shape < 1.5 ? (abs(p.x) + abs(p.y)) * 0.7071 : length(p);
          float radius = 0.5 * pixels;
          float cover = clamp(radius - away + 0.5, 0.0, 1.0);
          if (shape > 1.5) cover *= clamp(away - (radius - 2.2) + 0.5, 0.0, 1.0);
          if (cover <= 0.0) discard;
          // a dark rim keeps marks apart from what lies behind them
          float rim = shape > 0.5 && shape < 1.5 ? smoothstep(radius - 2.0, radius - 0.8, away) : 0.0;
          gl_FragColor = vec4(mix(shade, vec3(0.02), 0.75 * rim), cover);
          #include <colorspace_fragment>
        }`,
      transparent: true,
      depthTest: false,
      depthWrite: false,
    });
  }
}

/** The path of one joint. */
class Path {
  readonly positions: Float32Array;
  readonly dense: boolean;
  readonly line: LineSegments2;
  readonly dots: THREE.Points<THREE.BufferGeometry, DotMaterial>;

  constructor(
    readonly joint: number,
    readonly keys: PathKeys,
    /** Which samples are keys of this joint. */
    readonly isKey: Uint8Array,
    count: number,
  ) {
    // a key on nearly every frame: small marks, or they would be a wall
    this.dense = 3 * isKey.reduce((sum, v) => sum + v, 0) > count;
    this.positions = new Float32Array(3 * count).fill(NaN);
    const segments = Math.max(1, count - 1);
    const geometry = new LineSegmentsGeometry();
    geometry.setPositions(new Float32Array(6 * segments));
    geometry.setColors(new Float32Array(6 * segments));
    this.line = new LineSegments2(geometry, new LineMaterial({ linewidth: 2.2, vertexColors: true, depthTest: false, transparent: true, toneMapped: false }));
    const dots = new THREE.BufferGeometry();
    dots.setAttribute("position", new THREE.BufferAttribute(this.positions, 3));
    dots.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
    dots.setAttribute("look", new THREE.BufferAttribute(new Float32Array(2 * count), 2));
    // never culled, and what is not measured yet is no number: three.js need not look for bounds
    dots.boundingSphere = geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(), 1e3);
    this.dots = new THREE.Points(dots, new DotMaterial());
    this.line.renderOrder = -2;
    this.dots.renderOrder = -1;
    this.line.frustumCulled = this.dots.frustumCulled = false;
  }

  dispose(): void {
    this.line.removeFromParent();
    this.dots.removeFromParent();
    this.line.geometry.dispose();
    this.line.material.dispose();
    this.dots.geometry.dispose();
    this.dots.material.dispose();
  }
}

export class MotionPaths {
  readonly group = new THREE.Group();
  hovered: PathKey | null = null;
  speedColors = true;
  private actor: Actor | null = null;
  private paths: Path[] = [];
  private times: Float64Array = new Float64Array(0);
  private isFrame = new Uint8Array(0);
  private stale = new Uint8Array(0);
  private staleCount = 0;
  private drawn = NaN;
  private pose = new Pose(0, 0);
  private world = new Float64Array(0);
  private signature = "";
  private readonly color = new THREE.Color();
  private readonly point = new THREE.Vector3();

  constructor(private readonly view: Viewport) {}

  /** Show the paths of these joints over a range; measured times stay where nothing but the selection changed. */
  show(actor: Actor | null, joints: readonly number[], range: { start: number; end: number; rate: number } | null, keysOf: (joint: number) => PathKeys): void {
    if (!actor || !range || joints.length === 0) {
      this.clear();
      return;
    }
    const keys = joints.map(keysOf);
    const times = sampleTimes(range, keys);
    const signature = `${actor.id} ${joints.join()} ${range.start} ${range.end} ${range.rate} ${keys.map((k) => `${k.draggable}:${k.times.join()}`).join(";")}`;
    if (signature !== this.signature || actor !== this.actor) {
      this.clear();
      this.actor = actor;
      this.signature = signature;
      this.times = times;
      this.isFrame = Uint8Array.from(times, (t) => Number(Math.abs((t - range.start) * range.rate - Math.round((t - range.start) * range.rate)) < SAME * range.rate));
      this.stale = new Uint8Array(times.length);
      this.pose = actor.rig.newPose();
      this.world = new Float64Array(12 * actor.rig.count);
      this.paths = joints.map((joint, n) => new Path(joint, keys[n], Uint8Array.from(times, (t) => Number(keys[n].times.some((k) => Math.abs(k - t) < SAME))), times.length));
      for (const path of this.paths) this.group.add(path.line, path.dots);
    }
    this.invalidate();
  }

  clear(): void {
    for (const path of this.paths) path.dispose();
    this.paths = [];
    this.actor = null;
    this.signature = "";
    this.staleCount = 0;
    this.hovered = null;
  }

  /** Something was edited: all places are to be measured again. */
  invalidate(): void {
    this.stale.fill(1);
    this.staleCount = this.stale.length;
    this.drawn = NaN;
    this.view.invalidate();
  }

  get complete(): boolean {
    return this.staleCount === 0;
  }

  /** Before each picture: measure for a while, and colour what changed. */
  prepare(now: number, budget = BUDGET_MS): void {
    const { actor } = this;
    if (!actor || this.paths.length === 0) return;
    this.group.position.copy(actor.root.position);
    this.group.scale.copy(actor.root.scale);
    this.group.visible = actor.visible;
    const measured = this.measure(now, budget);
    if (measured || this.drawn !== now) {
      this.drawn = now;
      for (const path of this.paths) this.paint(path, now);
    }
    if (this.staleCount > 0) requestAnimationFrame(() => this.view.invalidate());
  }

  private measure(now: number, budget: number): boolean {
    if (this.staleCount === 0) return false;
    const { actor, times, stale, paths } = this;
    const began = performance.now();
    // from the present outwards to both sides
    let right = times.findIndex((t) => t >= now - SAME), left = right - 1;
    if (right < 0) [right, left] = [times.length, times.length - 1];
    while (left >= 0 || right < times.length) {
      const next = right >= times.length || (left >= 0 && now - times[left] < times[right] - now) ? left-- : right++;
      if (!stale[next]) continue;
      actor!.evaluate(times[next], this.pose, this.world);
      for (const path of paths) {
        const o = 12 * path.joint + 9;
        path.positions[3 * next] = this.world[o];
        path.positions[3 * next + 1] = this.world[o + 1];
        path.positions[3 * next + 2] = this.world[o + 2];
      }
      stale[next] = 0;
      if (--this.staleCount === 0 || performance.now() - began > budget) break;
    }
    return true;
  }

  private paint(path: Path, now: number): void {
    const { times, isFrame, color } = this;
    const { positions: p, isKey } = path;
    const palette = PALETTES[this.view.theme];
    const ink = this.view.theme === "dark" ? palette.overlayBone : palette.shadow;
    const count = times.length;
    const speeds = new Float64Array(count);
    let fastest = 0;
    for (let n = 0; n < count; n++) {
      const a = Math.max(0, n - 1), b = Math.min(count - 1, n + 1);
      const speed = Math.hypot(p[3 * b] - p[3 * a], p[3 * b + 1] - p[3 * a + 1], p[3 * b + 2] - p[3 * a + 2]) / Math.max(1e-9, times[b] - times[a]);
      speeds[n] = speed === speed ? speed : 0;
      fastest = Math.max(fastest, speeds[n]);
    }
    const shade = (n: number) => {
      if (!this.speedColors) return color.copy(times[n] < now ? palette.ghostBefore : palette.ghostAfter);
      return ramp(fastest > 1e-9 ? speeds[n] / fastest : 0, color);
    };
    const { geometry } = path.line;
    const ends = (geometry.attributes.instanceStart as THREE.InterleavedBufferAttribute).data;
    const shades = (geometry.attributes.instanceColorStart as THREE.InterleavedBufferAttribute).data;
    const line = ends.array as Float32Array, tint = shades.array as Float32Array;
    for (let n = 0; n + 1 < count; n++) {
      const known = p[3 * n] === p[3 * n] && p[3 * n + 3] === p[3 * n + 3];
      for (let c = 0; c < 3; c++) {
        line[6 * n + c] = known ? p[3 * n + c] : 0;
        line[6 * n + 3 + c] = known ? p[3 * n + 3 + c] : 0;
      }
      shade(n).toArray(tint, 6 * n);
      shade(n + 1).toArray(tint, 6 * n + 3);
    }
    ends.needsUpdate = shades.needsUpdate = true;
    const { position, color: colors, look } = path.dots.geometry.attributes as Record<string, THREE.BufferAttribute>;
    const rgb = colors.array as Float32Array, looks = look.array as Float32Array;
    for (let n = 0; n < count; n++) {
      // keys on every frame that nobody can drag say nothing: ticks do, and let the speed be seen
      const here = Math.abs(times[n] - now) < 1e-6, key = isKey[n] === 1 && (path.keys.draggable || !path.dense);
      const hot = this.hovered?.joint === path.joint && Math.abs(this.hovered.time - times[n]) < SAME;
      (key ? color.copy(hot ? palette.hover : palette.accent) : here ? color.copy(ink) : shade(n).lerp(ink, 0.35)).toArray(rgb, 3 * n);
      looks[2 * n] = key ? (hot ? 13 : path.dense ? 6 : path.keys.draggable ? 11 : 8) : here ? 11 : isFrame[n] ? 4.5 : 0;
      looks[2 * n + 1] = key ? (path.keys.draggable ? 1 : 0) : here ? 2 : 0;
      if (key && here) looks[2 * n] += 2;
    }
    position.needsUpdate = colors.needsUpdate = look.needsUpdate = true;
    path.dots.material.uniforms.ratio.value = Math.min(2, devicePixelRatio);
  }

  // ---- pointing --------------------------------------------------------------------------------------------------------

  /** The draggable key at a point of the canvas. */
  keyAt(x: number, y: number): PathKey | null {
    const { actor, times } = this;
    if (!actor || !this.group.visible) return null;
    let best: PathKey | null = null, nearest = GRAB_PX;
    for (const path of this.paths) {
      if (!path.keys.draggable) continue;
      for (let n = 0; n < times.length; n++) {
        if (!path.isKey[n] || path.positions[3 * n] !== path.positions[3 * n]) continue;
        const [sx, sy, depth] = this.view.project(actor, this.point.fromArray(path.positions, 3 * n));
        const distance = depth === Infinity ? Infinity : Math.hypot(sx - x, sy - y);
        if (distance < nearest) {
          nearest = distance;
          best = { joint: path.joint, time: times[n], position: new THREE.Vector3().fromArray(path.positions, 3 * n) };
        }
      }
    }
    return best;
  }

  hoverAt(x: number, y: number): void {
    const found = this.keyAt(x, y);
    if (found?.joint === this.hovered?.joint && found?.time === this.hovered?.time) return;
    this.hovered = found;
    this.drawn = NaN;
    this.view.invalidate();
  }

  /** What is drawn, for tests: times, places and which of them are keys. */
  report(): { joint: number; times: number[]; positions: number[]; keys: number[]; draggable: boolean }[] {
    return this.paths.map(({ joint, positions, isKey, keys }) => ({
      joint,
      times: [...this.times],
      positions: [...positions],
      keys: [...this.times].filter((_, n) => isKey[n] === 1),
      draggable: keys.draggable,
    }));
  }

  dispose(): void {
    this.clear();
    this.group.removeFromParent();
  }
}

/** Every frame of the range and every key in it, ascending. */
function sampleTimes({ start, end, rate }: { start: number; end: number; rate: number }, keys: PathKeys[]): Float64Array {
  const frames = Math.max(1, Math.floor((end - start) * rate + 1e-6) + 1);
  const all = Array.from({ length: frames }, (_, f) => start + f / rate);
  for (const { times } of keys) for (const t of times) if (t >= start - SAME && t <= end + SAME) all.push(t);
  all.sort((a, b) => a - b);
  return Float64Array.from(all.filter((t, n) => n === 0 || t - all[n - 1] > SAME));
}
