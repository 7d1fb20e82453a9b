// A skeleton as plain lines: the ghosts of a file without a mesh.

import * as THREE from "three";
import type { Rig } from "../anim/rig";

export class Sticks {
  readonly lines: THREE.LineSegments;
  private readonly positions: Float32Array;
  private readonly joints: number[];

  constructor(
    private readonly rig: Rig,
    color: THREE.Color,
    opacity: number,
  ) {
    this.joints = [...rig.parents.keys()].filter((joint) => rig.parents[joint] >= 0);
    this.positions = new Float32Array(6 * this.joints.length);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.positions, 3));
    const material = new THREE.LineBasicMaterial({ color, transparent: true, opacity, toneMapped: false });
    this.lines = new THREE.LineSegments(geometry, material);
    this.lines.frustumCulled = false;
  }

  write(world: Float64Array): void {
    for (let n = 0; n < this.joints.length; n++) {
      const a = 12 * this.joints[n] + 9, b = 12 * this.rig.parents[this.joints[n]] + 9;
      for (let c = 0; c < 3; c++) {
        this.positions[6 * n + c] = world[a + c];
        this.positions[6 * n + 3 + c] = world[b + c];
      }
    }
    this.lines.geometry.attributes.position.needsUpdate = true;
  }

  dispose(): void {
    this.lines.removeFromParent();
    this.lines.geometry.dispose();
    (this.lines.material as THREE.Material).dispose();
  }
}
