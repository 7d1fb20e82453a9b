// The orbit camera: damping, framing, presets, parallel views along the axes, and following a moving character.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

export type View = "front" | "side" | "back" | "top" | "three-quarter";

const DIRECTIONS: Record<View, [number, number, number]> = {
  front: [0, 0.06, 1],
  side: [1, 0.06, 0],
  back: [0, 0.06, -1],
  top: [0, 1, 0.001],
  "three-quarter": [0.62, 0.26, 1],
};

interface Move {
  fromTarget: THREE.Vector3;
  toTarget: THREE.Vector3;
  from: THREE.Spherical;
  to: THREE.Spherical;
  fromZoom: number;
  began: number;
}

const MOVE_MS = 320;
const FOV_DEG = 32;

export type Camera = THREE.PerspectiveCamera | THREE.OrthographicCamera;

export class OrbitCamera {
  /** The camera in use: `perspective` or `parallel`, which share place and direction. */
  camera: Camera;
  readonly controls: OrbitControls;
  readonly perspective = new THREE.PerspectiveCamera(FOV_DEG, 1, 0.05, 200);
  private readonly parallel = new THREE.OrthographicCamera();
  private aspect = 1;
  /** The axis that a parallel view was chosen for: turned away from it, the view is in perspective again. */
  private axis: THREE.Vector3 | null = null;
  private move: Move | null = null;
  private readonly followed = new THREE.Vector3();
  private following = false;
  private readonly delta = new THREE.Vector3();

  constructor(element: HTMLElement, changed: () => void) {
    this.camera = this.perspective;
    this.controls = new OrbitControls(this.camera, element);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.12;
    this.controls.zoomToCursor = false;
    this.controls.screenSpacePanning = true;
    this.controls.addEventListener("change", changed);
    this.controls.addEventListener("start", () => {
      this.move = null;
      changed();
    });
    this.camera.position.set(2.2, 1.6, 4);
    this.controls.target.set(0, 0.9, 0);
  }

  get target(): THREE.Vector3 {
    return this.controls.target;
  }

  resize(width: number, height: number): void {
    this.aspect = width / Math.max(1, height);
    this.project();
  }

  /** Bring the lens in line with the window and, of a parallel view, with the distance. */
  private project(): void {
    const { perspective, parallel } = this;
    perspective.aspect = this.aspect;
    perspective.updateProjectionMatrix();
    const half = Math.tan((FOV_DEG * Math.PI) / 360) * this.camera.position.distanceTo(this.controls.target);
    parallel.top = half;
    parallel.bottom = -half;
    parallel.right = half * this.aspect;
    parallel.left = -parallel.right;
    parallel.near = -perspective.far;
    parallel.far = perspective.far;
    parallel.updateProjectionMatrix();
  }

  get isParallel(): boolean {
    return this.camera === this.parallel;
  }

  /** Parallel or in perspective, at the same place and with the same size of what is looked at. */
  setParallel(parallel: boolean): void {
    this.axis = null;
    if (parallel === this.isParallel) return;
    const { camera: before, controls } = this;
    const next = parallel ? this.parallel : this.perspective;
    next.position.copy(before.position);
    next.quaternion.copy(before.quaternion);
    // a parallel view zooms where the other comes nearer
    if (!parallel) next.position.sub(controls.target).divideScalar(this.parallel.zoom).add(controls.target);
    this.parallel.zoom = 1;
    this.camera = controls.object = next;
    this.project();
    controls.update();
  }

  /** Look exactly along a direction, in parallel, until the camera is turned. */
  lookAlong(direction: THREE.Vector3): void {
    this.setParallel(true);
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.go(this.controls.target.clone(), direction.clone().normalize().multiplyScalar(distance), false, this.parallel.zoom);
    this.axis = direction.clone().normalize();
  }

  /** Turn about the target by angles in radians. */
  turn(around: number, over: number): void {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const at = new THREE.Spherical().setFromVector3(offset);
    at.theta += around;
    at.phi += over;
    this.go(this.controls.target.clone(), offset.setFromSpherical(at.makeSafe()), false, this.parallel.zoom);
  }

  /** Show a box whole, from the present direction or a named one. */
  frame(box: THREE.Box3, view: View | null, immediately = false, turn = 1): void {
    const center = box.getCenter(new THREE.Vector3());
    const size = box.getSize(new THREE.Vector3());
    const direction = view
      ? new THREE.Vector3(...DIRECTIONS[view])
      : this.camera.position.clone().sub(this.controls.target);
    if (view === "three-quarter") direction.x *= turn;
    direction.normalize();
    const vertical = Math.tan((FOV_DEG * Math.PI) / 360);
    const flat = Math.hypot(direction.x, direction.z);
    const wide = Math.abs(direction.z) * size.x + Math.abs(direction.x) * size.z;
    const high = flat * size.y + Math.abs(direction.y) * Math.hypot(size.x, size.z);
    const depth = Math.abs(direction.x) * size.x + Math.abs(direction.z) * size.z;
    const distance = Math.max(high / vertical, wide / (vertical * this.aspect)) * 0.5 * 1.22 + 0.5 * depth;
    const reach = Math.max(size.x, size.y, size.z);
    this.perspective.near = Math.max(1e-4, reach * 0.01);
    this.perspective.far = reach * 120;
    this.project();
    this.controls.minDistance = reach * 0.05;
    this.controls.maxDistance = reach * 40;
    this.go(center, direction.multiplyScalar(distance), immediately);
  }

  private go(target: THREE.Vector3, offset: THREE.Vector3, immediately: boolean, zoom = 1): void {
    if (immediately || matchMedia("(prefers-reduced-motion: reduce)").matches) {
      this.move = null;
      this.controls.target.copy(target);
      this.camera.position.copy(target).add(offset);
      this.parallel.zoom = zoom;
      this.project();
      this.controls.update();
      return;
    }
    const from = new THREE.Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
    const to = new THREE.Spherical().setFromVector3(offset);
    // turn the short way around
    to.theta = from.theta + Math.atan2(Math.sin(to.theta - from.theta), Math.cos(to.theta - from.theta));
    this.move = { fromTarget: this.controls.target.clone(), toTarget: target, from, to, fromZoom: this.parallel.zoom / zoom, began: performance.now() };
    this.zoomGoal = zoom;
  }

  private zoomGoal = 1;

  /** Called before each drawn frame; returns whether the camera still moves. */
  update(now: number): boolean {
    const { move } = this;
    if (move) {
      const u = Math.min(1, Math.max(0, (now - move.began) / MOVE_MS));
      const e = 1 - (1 - u) ** 3;
      const mix = (a: number, b: number) => a + e * (b - a);
      this.controls.target.lerpVectors(move.fromTarget, move.toTarget, e);
      const offset = new THREE.Vector3().setFromSpherical(
        new THREE.Spherical(mix(move.from.radius, move.to.radius), mix(move.from.phi, move.to.phi), mix(move.from.theta, move.to.theta)).makeSafe(),
      );
      this.camera.position.copy(this.controls.target).add(offset);
      this.parallel.zoom = this.zoomGoal * move.fromZoom ** (1 - e);
      if (u >= 1) this.move = null;
      this.project();
    }
    const moved = this.controls.update() || this.move !== null;
    if (this.axis && !this.move) {
      const offset = this.delta.subVectors(this.camera.position, this.controls.target).normalize();
      if (offset.dot(this.axis) < 0.9999) this.setParallel(false);
    }
    return moved;
  }

  /** Keep a moving point in view by moving along with it. */
  follow(point: THREE.Vector3 | null): void {
    if (!point) {
      this.following = false;
      return;
    }
    if (this.following) {
      this.delta.subVectors(point, this.followed);
      this.camera.position.add(this.delta);
      this.controls.target.add(this.delta);
      this.move?.fromTarget.add(this.delta);
      this.move?.toTarget.add(this.delta);
    }
    this.followed.copy(point);
    this.following = true;
  }
}
