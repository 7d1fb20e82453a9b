// How the camera sees a character's own space.

import * as THREE from "three";
import type { Actor } from "../../view/actor";
import type { Viewport } from "../../view/viewport";
import type { Sight } from "./drag";
import { unit, type Vec } from "./spaces";

export class CameraSight implements Sight {
  private readonly point = new THREE.Vector3();
  private readonly far = new THREE.Vector3();

  constructor(
    private readonly view: Viewport,
    private readonly actor: Actor,
  ) {}

  private fromStage(point: THREE.Vector3): Vec {
    const { root, scale } = this.actor;
    return [(point.x - root.position.x) / scale, (point.y - root.position.y) / scale, (point.z - root.position.z) / scale];
  }

  ray(x: number, y: number): { origin: Vec; direction: Vec } {
    const { clientWidth: w, clientHeight: h } = this.view.canvas, { camera } = this.view.orbit;
    const nx = (2 * x) / w - 1, ny = 1 - (2 * y) / h;
    this.point.set(nx, ny, -1).unproject(camera);
    this.far.set(nx, ny, 1).unproject(camera).sub(this.point).normalize();
    return { origin: this.fromStage(this.point), direction: [this.far.x, this.far.y, this.far.z] };
  }

  screen(place: Vec): [number, number] {
    const [x, y] = this.view.project(this.actor, this.point.set(...(place as [number, number, number])));
    return [x, y];
  }

  toEye(place: Vec): Vec {
    const { camera } = this.view.orbit;
    if (camera instanceof THREE.OrthographicCamera) return this.picture[2];
    this.actor.toStage(this.point.set(...(place as [number, number, number])));
    const eye = this.far.copy(camera.position).sub(this.point);
    return unit([eye.x, eye.y, eye.z]);
  }

  get picture(): [Vec, Vec, Vec] {
    const e = this.view.orbit.camera.matrixWorld.elements;
    return [
      [e[0], e[1], e[2]],
      [e[4], e[5], e[6]],
      [e[8], e[9], e[10]],
    ];
  }

  metresPerPixel(place: Vec): number {
    const { camera } = this.view.orbit, height = this.view.canvas.clientHeight;
    if (camera instanceof THREE.OrthographicCamera) return (camera.top - camera.bottom) / camera.zoom / height / this.actor.scale;
    this.actor.toStage(this.point.set(...(place as [number, number, number]))).applyMatrix4(camera.matrixWorldInverse);
    return (2 * Math.max(1e-6, -this.point.z) * Math.tan((camera.fov * Math.PI) / 360)) / height / this.actor.scale;
  }
}
