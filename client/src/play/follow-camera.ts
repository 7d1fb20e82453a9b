// A camera over the shoulder: it glides along with the character, swings behind it unless someone holds it, and is turned
// by dragging.

import * as THREE from "three";
import { wrap } from "./driver";

const BEHIND_HALF_LIFE_S = 0.9;
const HANDS_OFF_S = 1.2;
const GLIDE_HALF_LIFE_S = 0.055;
const RISE_HALF_LIFE_S = 0.22;

export class FollowCamera {
  readonly camera = new THREE.PerspectiveCamera(34, 1, 0.05, 400);
  /** Direction in which it looks over the ground: 0 is along +Z, rising to the left. */
  heading = 0;
  private pitch = 0.21;
  private distance = 5;
  private height = 1.8;
  private middle = 0.9;
  private hips = 0.9;
  following = true;
  private readonly target = new THREE.Vector3(0, 0.95, 0);
  private held = false;
  private touchedAt = -Infinity;
  private settled = false;

  resize(width: number, height: number): void {
    this.camera.aspect = width / Math.max(1, height);
    // a narrow window shows the whole character too
    this.camera.fov = this.camera.aspect < 0.9 ? 46 : 34;
    this.camera.updateProjectionMatrix();
  }

  /** Stand behind a character of this height, its middle `middle` over the ground and its hips `hips`. */
  fit(height: number, middle: number, hips: number, x: number, z: number, yaw: number): void {
    this.height = height;
    this.middle = middle;
    this.hips = hips;
    this.distance = 2.8 * height;
    this.pitch = 0.21;
    this.heading = yaw;
    this.target.set(x, middle, z);
    this.settled = false;
  }

  hold(held: boolean): void {
    this.held = held;
    this.touchedAt = performance.now();
  }

  turn(dx: number, dy: number): void {
    this.heading = wrap(this.heading - dx);
    this.pitch = Math.max(-0.12, Math.min(1.45, this.pitch + dy));
    this.touchedAt = performance.now();
    this.settled = false;
  }

  zoom(factor: number): void {
    this.distance = Math.max(0.7 * this.height, Math.min(14 * this.height, this.distance * factor));
    this.settled = false;
  }

  /** Stand behind the character again, and follow. */
  center(yaw: number): void {
    this.heading = yaw;
    this.pitch = 0.21;
    this.settled = false;
  }

  /** Move with the character (`point`: its hips); returns whether the picture changed. */
  update(dt: number, point: THREE.Vector3, yaw: number, speed: number): boolean {
    if (!this.following && this.settled) return false;
    let moved = !this.settled;
    if (this.following) {
      const glide = 1 - 2 ** (-dt / GLIDE_HALF_LIFE_S), rise = 1 - 2 ** (-dt / RISE_HALF_LIFE_S);
      const dx = point.x - this.target.x, dz = point.z - this.target.z;
      const dy = this.middle + 0.75 * (point.y - this.hips) - this.target.y;
      if (Math.hypot(dx, dz) > 6 * this.height) this.target.set(point.x, this.target.y, point.z);
      else this.target.set(this.target.x + glide * dx, this.target.y + rise * dy, this.target.z + glide * dz);
      moved ||= Math.hypot(dx, dy, dz) > 1e-5;
      if (!this.held && performance.now() - this.touchedAt > 1000 * HANDS_OFF_S && speed > 0.2) {
        const off = wrap(yaw - this.heading);
        // walking towards the camera is wanted: it does not swing around then
        const share = Math.max(0, Math.cos(off / 2)) ** 2 * Math.min(1, speed);
        this.heading = wrap(this.heading + off * share * (1 - 2 ** (-dt / BEHIND_HALF_LIFE_S)));
        moved ||= Math.abs(off) > 1e-4;
      }
    }
    const flat = Math.cos(this.pitch) * this.distance;
    this.camera.position.set(
      this.target.x - Math.sin(this.heading) * flat,
      Math.max(0.05 * this.height, this.target.y + Math.sin(this.pitch) * this.distance),
      this.target.z - Math.cos(this.heading) * flat,
    );
    this.camera.lookAt(this.target);
    this.settled = true;
    return moved;
  }
}
