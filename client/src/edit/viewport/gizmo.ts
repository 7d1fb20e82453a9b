// The handles at the selected joint: drawn in three.js at one size on the screen, found by distance on the screen.

import * as THREE from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import type { Theme } from "../../view/palette";
import type { Basis, Vec } from "./spaces";
import type { Mode } from "./manipulate";

export type Handle = "x" | "y" | "z" | "yz" | "zx" | "xy" | "screen" | "free";
export const AXIS_HANDLES = ["x", "y", "z"] as const;
export const PLANE_HANDLES = ["yz", "zx", "xy"] as const;

/** Radius of the rings and reach of the arrows, in CSS pixels. */
const SIZE = 84;
const REACH = 9;
const RING_STEPS = 96;
const SCREEN_RING = 1.2;
const PLANE_AT = 0.34;
const PLANE_SIZE = 0.13;

const COLORS: Record<Theme, Record<"x" | "y" | "z" | "plain" | "hot", THREE.Color>> = {
  dark: { x: new THREE.Color(0xf0525a), y: new THREE.Color(0x54bd63), z: new THREE.Color(0x4b8bff), plain: new THREE.Color(0xe8e9ec), hot: new THREE.Color(0xffd24a) },
  light: { x: new THREE.Color(0xd6333b), y: new THREE.Color(0x2f8f40), z: new THREE.Color(0x2463e0), plain: new THREE.Color(0x3a3d44), hot: new THREE.Color(0xff8a00) },
};

/** One colour, in front of everything; what turns its back to the eye is faint where `faint` says so. */
class HandleMaterial extends THREE.ShaderMaterial {
  constructor(faint: boolean) {
    super({
      uniforms: { color: { value: new THREE.Color() }, opacity: { value: 1 }, behind: { value: faint ? 0.16 : 1 } },
      vertexShader: /* glsl */ `
        uniform float behind;
        varying float alpha;
        void main() {
          vec4 at = modelViewMatrix * vec4(position, 1.0);
          vec3 centre = (modelViewMatrix * vec4(0.0, 0.0, 0.0, 1.0)).xyz;
          // towards the eye: the origin of a view in perspective, the axis of a parallel one
          vec3 eye = isOrthographic ? vec3(0.0, 0.0, 1.0) : normalize(-centre);
          float facing = dot(normalize(at.xyz - centre), eye);
          alpha = mix(behind, 1.0, smoothstep(-0.12, 0.06, facing));
          gl_Position = projectionMatrix * at;
        }`,
      fragmentShader: /* glsl */ `
        uniform vec3 color;
        uniform float opacity;
        varying float alpha;
        void main() {
          gl_FragColor = vec4(color, opacity * alpha);
          #include <colorspace_fragment>
        }`,
      transparent: true,
      depthTest: false,
      depthWrite: false,
      side: THREE.DoubleSide,
    });
  }
}

interface Piece {
  readonly handle: Handle;
  readonly mesh: THREE.Mesh<THREE.BufferGeometry, HandleMaterial>;
  readonly color: "x" | "y" | "z" | "plain";
  readonly opacity: number;
  readonly hotOpacity: number;
}

const Y = new THREE.Vector3(0, 1, 0);

export class Gizmo {
  readonly group = new THREE.Group();
  mode: Mode | null = "rotate";
  hovered: Handle | null = null;
  /** The handle that is dragged: the others are hidden. */
  active: Handle | null = null;
  /** Whether there is something to hold on to. */
  present = false;
  private readonly turning = new THREE.Group();
  private readonly facing = new THREE.Group();
  private readonly pieces: Record<Mode, Piece[]> = { move: [], rotate: [], scale: [] };
  private readonly sector: THREE.Mesh<THREE.BufferGeometry, HandleMaterial>;
  private readonly guide: LineSegments2;
  private guideEnds: number[] = [];
  private readonly place = new THREE.Vector3();
  private readonly basis = new THREE.Matrix4();
  private readonly camera: { current: THREE.Camera; width: number; height: number } = { current: new THREE.Camera(), width: 1, height: 1 };
  private theme: Theme = "dark";
  private size = 1;

  constructor() {
    this.group.add(this.turning, this.facing);
    this.build();
    this.sector = new THREE.Mesh(new THREE.BufferGeometry(), new HandleMaterial(false));
    this.sector.renderOrder = 2;
    this.sector.visible = false;
    this.guide = new LineSegments2(new LineSegmentsGeometry(), new LineMaterial({ linewidth: 1.4, depthTest: false, transparent: true, opacity: 0.75, toneMapped: false }));
    this.guide.visible = false;
    for (const mesh of [this.sector, this.guide]) mesh.frustumCulled = false;
    this.group.add(this.sector);
    this.group.visible = false;
  }

  /** Lines along the axes of a constraint, as far as one can see; a part of the stage, not of the gizmo. */
  get guides(): THREE.Object3D {
    return this.guide;
  }

  private build(): void {
    const piece = (mode: Mode, handle: Handle, geometry: THREE.BufferGeometry, color: Piece["color"], options: { faint?: boolean; opacity?: number; hot?: number; facing?: boolean; order?: number } = {}) => {
      const mesh = new THREE.Mesh(geometry, new HandleMaterial(options.faint ?? false));
      mesh.renderOrder = options.order ?? 4;
      mesh.frustumCulled = false;
      (options.facing ? this.facing : this.turning).add(mesh);
      this.pieces[mode].push({ handle, mesh, color, opacity: options.opacity ?? 0.95, hotOpacity: options.hot ?? 1 });
    };
    const directions: Record<"x" | "y" | "z", THREE.Quaternion> = {
      x: new THREE.Quaternion().setFromUnitVectors(Y, new THREE.Vector3(1, 0, 0)),
      y: new THREE.Quaternion(),
      z: new THREE.Quaternion().setFromUnitVectors(Y, new THREE.Vector3(0, 0, 1)),
    };
    const rod = (from: number, to: number, width: number) => new THREE.CylinderGeometry(width, width, to - from, 8).translate(0, 0.5 * (from + to), 0);
    for (const axis of AXIS_HANDLES) {
      const q = directions[axis];
      piece("rotate", axis, new THREE.TorusGeometry(1, 0.014, 6, RING_STEPS).rotateX(Math.PI / 2).applyQuaternion(q), axis, { faint: true });
      piece("move", axis, rod(0.14, 0.84, 0.013).applyQuaternion(q), axis);
      piece("move", axis, new THREE.ConeGeometry(0.062, 0.2, 20).translate(0, 0.92, 0).applyQuaternion(q), axis);
      piece("scale", axis, rod(0.14, 0.88, 0.013).applyQuaternion(q), axis);
      piece("scale", axis, new THREE.BoxGeometry(0.1, 0.1, 0.1).translate(0, 0.91, 0).applyQuaternion(q), axis);
    }
    for (const handle of PLANE_HANDLES) {
      const [u, v] = planeAxes(handle), color = normalOf(handle);
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => new THREE.Vector3().addScaledVector(u, PLANE_AT + a * 0.5 * PLANE_SIZE).addScaledVector(v, PLANE_AT + b * 0.5 * PLANE_SIZE));
      for (const mode of ["move", "scale"] as const) {
        const quad = new THREE.BufferGeometry().setFromPoints([corners[0], corners[1], corners[2], corners[0], corners[2], corners[3]]);
        piece(mode, handle, quad, color, { opacity: 0.42, hot: 0.85, order: 3 });
      }
    }
    piece("rotate", "free", new THREE.CircleGeometry(0.97, 64), "plain", { facing: true, opacity: 0, hot: 0.07, order: 1 });
    piece("rotate", "screen", new THREE.TorusGeometry(SCREEN_RING, 0.012, 6, RING_STEPS), "plain", { facing: true, opacity: 0.75 });
    piece("move", "screen", new THREE.RingGeometry(0.088, 0.11, 32), "plain", { facing: true, opacity: 0.9 });
    piece("move", "screen", new THREE.CircleGeometry(0.088, 32), "plain", { facing: true, opacity: 0.14, hot: 0.5 });
    piece("scale", "screen", new THREE.RingGeometry(0.088, 0.11, 32), "plain", { facing: true, opacity: 0.9 });
    piece("scale", "screen", new THREE.CircleGeometry(0.06, 32), "plain", { facing: true, opacity: 0.6, hot: 0.9 });
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
  }

  /** Stand at a place of the stage with these axes, unit vectors. */
  stand(place: THREE.Vector3, axes: Basis): void {
    this.place.copy(place);
    this.basis.makeBasis(new THREE.Vector3(...axes[0]), new THREE.Vector3(...axes[1]), new THREE.Vector3(...axes[2]));
  }

  /** Stage units in a CSS pixel where the gizmo stands. */
  get unitsPerPixel(): number {
    return this.size / SIZE;
  }

  /** Before each picture: one size on the screen, colours, what is shown. */
  update(camera: THREE.PerspectiveCamera | THREE.OrthographicCamera, width: number, height: number): void {
    this.camera.current = camera;
    this.camera.width = width;
    this.camera.height = height;
    this.group.visible = this.present && (this.mode !== null || this.active !== null);
    if (!this.present) return;
    let perPixel: number;
    if (camera instanceof THREE.PerspectiveCamera) {
      const depth = Math.max(1e-6, this.place.clone().applyMatrix4(camera.matrixWorldInverse).z * -1);
      perPixel = (2 * depth * Math.tan((camera.fov * Math.PI) / 360)) / height;
    } else perPixel = (camera.top - camera.bottom) / camera.zoom / height;
    this.size = SIZE * perPixel;
    this.group.position.copy(this.place);
    this.group.scale.setScalar(this.size);
    this.turning.matrixAutoUpdate = false;
    this.turning.matrix.copy(this.basis);
    this.facing.quaternion.copy(camera.quaternion);
    const colors = COLORS[this.theme];
    const hot = this.active ?? this.hovered;
    for (const mode of ["move", "rotate", "scale"] as const)
      for (const { handle, mesh, color, opacity, hotOpacity } of this.pieces[mode]) {
        mesh.visible = mode === this.mode && (this.active === null || this.active === handle);
        mesh.material.uniforms.color.value.copy(handle === hot ? colors.hot : colors[color]);
        mesh.material.uniforms.opacity.value = handle === hot ? hotOpacity : opacity;
      }
  }

  // ---- while something is dragged ------------------------------------------------------------------------------------

  /** The axes that a drag is bound to, as long lines through the gizmo; none hides them. */
  showGuides(axes: readonly ("x" | "y" | "z")[]): void {
    this.guide.visible = axes.length > 0;
    if (axes.length === 0) return;
    const e = this.basis.elements, far = 25 * this.size;
    this.guideEnds = axes.flatMap((axis) => {
      const a = 4 * AXIS_HANDLES.indexOf(axis);
      // in two halves from the gizmo, as one of its ends may lie behind the eye
      return [-far, 0, 0, far].flatMap((s) => [this.place.x + s * e[a], this.place.y + s * e[a + 1], this.place.z + s * e[a + 2]]);
    });
    this.guide.geometry.dispose();
    this.guide.geometry = new LineSegmentsGeometry().setPositions(this.guideEnds);
    this.guide.material.color.copy(COLORS[this.theme][axes.length === 1 ? axes[0] : "plain"]);
  }

  /** Ends of the lines that are shown. */
  guidePoints(): number[] {
    return this.guide.visible ? this.guideEnds : [];
  }

  /** The angle that was swept about an axis of the stage, from a direction; null hides it. */
  showSector(sweep: { axis: Vec; from: Vec; angle: number } | null): void {
    this.sector.visible = sweep !== null;
    if (!sweep) return;
    const steps = Math.max(2, Math.ceil(Math.min(2 * Math.PI, Math.abs(sweep.angle)) / 0.06));
    const axis = new THREE.Vector3(...sweep.axis), from = new THREE.Vector3(...sweep.from);
    const angle = Math.sign(sweep.angle) * Math.min(2 * Math.PI, Math.abs(sweep.angle));
    const rim = Array.from({ length: steps + 1 }, (_, n) => from.clone().applyAxisAngle(axis, (angle * n) / steps));
    const points = rim.slice(1).flatMap((p, n) => [new THREE.Vector3(), rim[n], p]);
    this.sector.geometry.dispose();
    this.sector.geometry = new THREE.BufferGeometry().setFromPoints(points);
    this.sector.material.uniforms.color.value.copy(COLORS[this.theme].hot);
    this.sector.material.uniforms.opacity.value = 0.22;
  }

  // ---- pointing ------------------------------------------------------------------------------------------------------

  /** A point of the gizmo's own axes on the canvas, in CSS pixels; null behind the eye. */
  private screen(point: THREE.Vector3, facing = false): [number, number] | null {
    const at = point.clone().applyMatrix4(facing ? new THREE.Matrix4().makeRotationFromQuaternion(this.camera.current.quaternion) : this.basis);
    at.multiplyScalar(this.size).add(this.place).project(this.camera.current);
    if (at.z > 1) return null;
    return [(0.5 + 0.5 * at.x) * this.camera.width, (0.5 - 0.5 * at.y) * this.camera.height];
  }

  /** Where the gizmo stands on the canvas. */
  centre(): [number, number] {
    return this.screen(new THREE.Vector3()) ?? [-1e6, -1e6];
  }

  /** How much an axis looks towards the eye: 1 at it, 0 across, -1 away. */
  facingOf(axis: THREE.Vector3): number {
    const camera = this.camera.current;
    const eye = camera instanceof THREE.OrthographicCamera ? new THREE.Vector3(0, 0, 1).applyQuaternion(camera.quaternion) : camera.position.clone().sub(this.place).normalize();
    return axis.dot(eye);
  }

  axis(handle: "x" | "y" | "z"): THREE.Vector3 {
    return new THREE.Vector3().setFromMatrixColumn(this.basis, AXIS_HANDLES.indexOf(handle));
  }

  /** The ring of an axis on the canvas; of the half that is turned away, nothing. */
  private ring(handle: "x" | "y" | "z"): ([number, number] | null)[] {
    const n = AXIS_HANDLES.indexOf(handle), point = new THREE.Vector3(), world = new THREE.Vector3();
    return Array.from({ length: RING_STEPS + 1 }, (_, k) => {
      const a = (2 * Math.PI * k) / RING_STEPS;
      point.set(0, 0, 0).setComponent((n + 1) % 3, Math.cos(a)).setComponent((n + 2) % 3, Math.sin(a));
      if (this.facingOf(world.copy(point).applyMatrix4(this.basis)) < -0.02) return null;
      return this.screen(point);
    });
  }

  /** The handle at a point of the canvas. */
  handleAt(x: number, y: number): Handle | null {
    if (!this.present || this.mode === null) return null;
    const reach = (points: ([number, number] | null)[]) => {
      let best = Infinity;
      for (let n = 1; n < points.length; n++) {
        const a = points[n - 1], b = points[n];
        if (a && b) best = Math.min(best, toSegment(x, y, a, b));
      }
      return best;
    };
    const [cx, cy] = this.centre();
    const away = Math.hypot(x - cx, y - cy);
    let found: Handle | null = null, nearest = REACH;
    const consider = (handle: Handle, distance: number) => {
      if (distance < nearest) [found, nearest] = [handle, distance];
    };
    if (this.mode === "rotate") {
      for (const handle of AXIS_HANDLES) consider(handle, reach(this.ring(handle)));
      consider("screen", Math.abs(away - SCREEN_RING * SIZE) + 1);
      return found ?? (away < 0.9 * SIZE ? "free" : null);
    }
    if (away < 0.12 * SIZE) return "screen";
    for (const handle of PLANE_HANDLES) {
      const [u, v] = planeAxes(handle);
      const middle = this.screen(new THREE.Vector3().addScaledVector(u, PLANE_AT).addScaledVector(v, PLANE_AT));
      // a plane seen from its edge cannot be dragged along
      if (middle && Math.abs(this.facingOf(this.axis(normalOf(handle)))) > 0.15) consider(handle, 0.6 * Math.hypot(x - middle[0], y - middle[1]));
    }
    for (const handle of AXIS_HANDLES) {
      if (Math.abs(this.facingOf(this.axis(handle))) > 0.985) continue;
      const unit = new THREE.Vector3().setComponent(AXIS_HANDLES.indexOf(handle), 1);
      consider(handle, reach([this.screen(unit.clone().multiplyScalar(0.14)), this.screen(unit)]) + 0.5);
    }
    return found;
  }

  /** A point of a handle on the canvas, for tests and hints. */
  pointOf(handle: Handle): [number, number] | null {
    if (!this.present || this.mode === null) return null;
    if (this.mode === "rotate") {
      if (handle === "free") {
        // somewhere inside that lies on no ring
        for (let n = 0; n < 24; n++) {
          const at = this.screen(new THREE.Vector3(0.5 * Math.cos(n), 0.5 * Math.sin(n), 0), true);
          if (at && this.handleAt(...at) === "free") return at;
        }
        return null;
      }
      if (handle === "screen") return this.screen(new THREE.Vector3(SCREEN_RING * Math.SQRT1_2, SCREEN_RING * Math.SQRT1_2, 0), true);
      if (handle !== "x" && handle !== "y" && handle !== "z") return null;
      const seen = this.ring(handle).filter((p): p is [number, number] => p !== null && this.handleAt(...p) === handle);
      return seen[Math.floor(seen.length / 3)] ?? null;
    }
    if (handle === "screen" || handle === "free") return this.centre();
    if (handle === "x" || handle === "y" || handle === "z") return this.screen(new THREE.Vector3().setComponent(AXIS_HANDLES.indexOf(handle), 0.8));
    const [u, v] = planeAxes(handle);
    return this.screen(new THREE.Vector3().addScaledVector(u, PLANE_AT).addScaledVector(v, PLANE_AT));
  }

  dispose(): void {
    this.group.removeFromParent();
    this.guide.removeFromParent();
    for (const { mesh } of Object.values(this.pieces).flat()) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    for (const mesh of [this.sector, this.guide]) {
      mesh.geometry.dispose();
      (mesh.material as THREE.Material).dispose();
    }
  }
}

/** The two directions of a plane. */
export function planeAxes(handle: "yz" | "zx" | "xy"): [THREE.Vector3, THREE.Vector3] {
  return [...handle].map((axis) => new THREE.Vector3().setComponent("xyz".indexOf(axis), 1)) as [THREE.Vector3, THREE.Vector3];
}

/** The axis at right angles to a plane. */
export function normalOf(handle: "yz" | "zx" | "xy"): "x" | "y" | "z" {
  return [..."xyz"].find((axis) => !handle.includes(axis)) as "x" | "y" | "z";
}

export function toSegment(x: number, y: number, [ax, ay]: readonly number[], [bx, by]: readonly number[]): number {
  const dx = bx - ax, dy = by - ay, l = dx * dx + dy * dy;
  const u = l > 0 ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / l)) : 0;
  return Math.hypot(ax + u * dx - x, ay + u * dy - y);
}
