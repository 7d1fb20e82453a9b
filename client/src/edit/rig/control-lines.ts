// The controls of a rig on the stage: coloured outlines over everything, found again under the pointer.

import * as THREE from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import type { RigData } from "../../generated/messages";
import type { Actor } from "../../view/actor";
import type { Marks } from "../../view/bones";
import { PALETTES, type Theme } from "../../view/palette";
import { segmentsOf } from "./shapes";

const COLORS: Record<Theme, Record<"left" | "middle" | "right", THREE.Color>> = {
  dark: { left: new THREE.Color(0x4da3ff), middle: new THREE.Color(0xf2cf3b), right: new THREE.Color(0xff5d6c) },
  light: { left: new THREE.Color(0x0f62c4), middle: new THREE.Color(0xa87b00), right: new THREE.Color(0xc8203a) },
};
const WIDTH_PX = 1.9;
/** How much is left of the colour of a control that moves nothing now, because its limb goes by the other side. */
const IDLE: Record<Theme, { color: THREE.Color; left: number }> = {
  dark: { color: new THREE.Color(0x23262c), left: 0.22 },
  light: { color: new THREE.Color(0xd9d7d1), left: 0.25 },
};

export class ControlLines {
  readonly lines: LineSegments2;
  private readonly local: Float64Array[];
  private readonly first: number[] = [];
  private readonly places: Float32Array;
  private readonly colors: Float32Array;
  private readonly material = new LineMaterial({ vertexColors: true, linewidth: WIDTH_PX, depthTest: false, transparent: true });

  constructor(
    readonly actor: Actor,
    readonly data: RigData,
  ) {
    this.local = data.controls.map(segmentsOf);
    let count = 0;
    for (const segments of this.local) {
      this.first.push(count);
      count += segments.length / 6;
    }
    const geometry = new LineSegmentsGeometry();
    geometry.setPositions(new Float32Array(6 * count));
    geometry.setColors(new Float32Array(6 * count).fill(1));
    const array = (name: string) => (geometry.attributes[name] as THREE.InterleavedBufferAttribute).data.array as Float32Array;
    this.places = array("instanceStart");
    this.colors = array("instanceColorStart");
    this.lines = new LineSegments2(geometry, this.material);
    this.lines.frustumCulled = false;
    this.lines.renderOrder = -1;
  }

  /** Whether a control moves nothing as the numbers of the pose are: FK of a limb that goes by IK, or the other way round. */
  idle(joint: number): boolean {
    const name = this.actor.rig.names[joint];
    const module = this.data.modules.find((m) => m.switch !== "" && (m.fk.includes(name) || m.ik.includes(name)));
    if (!module) return false;
    const share = this.actor.rig.pose.morphs[this.actor.rig.attributeIndex(module.switch)];
    // the spine's goal bends what FK gives: there, FK is never idle
    return module.ik.includes(name) ? share < 1e-6 : module.kind === "limb" && share > 1 - 1e-6;
  }

  /** The shares of all switches, as a text that is another when one of them is. */
  get switches(): string {
    const { rig } = this.actor;
    return this.data.modules.map((m) => (m.switch ? rig.pose.morphs[rig.attributeIndex(m.switch)] : "")).join();
  }

  /** Bring the lines to where the controls are. */
  write(): void {
    const { rig } = this.actor, { world } = rig, { places } = this;
    const { position } = this.actor.root, { scale } = this.actor;
    let o = 0;
    this.local.forEach((segments, control) => {
      const m = 12 * (rig.jointCount + control);
      for (let n = 0; n < segments.length; n += 3) {
        const x = segments[n], y = segments[n + 1], z = segments[n + 2];
        places[o++] = scale * (world[m] * x + world[m + 3] * y + world[m + 6] * z + world[m + 9]) + position.x;
        places[o++] = scale * (world[m + 1] * x + world[m + 4] * y + world[m + 7] * z + world[m + 10]) + position.y;
        places[o++] = scale * (world[m + 2] * x + world[m + 5] * y + world[m + 8] * z + world[m + 11]) + position.z;
      }
    });
    (this.lines.geometry.attributes.instanceStart as THREE.InterleavedBufferAttribute).data.needsUpdate = true;
  }

  paint(theme: Theme, marks: Marks): void {
    const { jointCount } = this.actor.rig, palette = PALETTES[theme];
    const color = new THREE.Color();
    this.data.controls.forEach(({ side }, control) => {
      const joint = jointCount + control;
      if (joint === marks.active) color.copy(palette.accent);
      else if (joint === marks.hovered) color.copy(palette.hover);
      else if (marks.selected.has(joint)) color.copy(palette.selected);
      else if (marks.held.has(joint)) color.copy(palette.held);
      else {
        color.copy(COLORS[theme][side]);
        if (this.idle(joint)) color.lerp(IDLE[theme].color, 1 - IDLE[theme].left);
      }
      const end = 6 * (this.first[control] + this.local[control].length / 6);
      for (let o = 6 * this.first[control]; o < end; o += 3) color.toArray(this.colors, o);
    });
    (this.lines.geometry.attributes.instanceColorStart as THREE.InterleavedBufferAttribute).data.needsUpdate = true;
  }

  /** The control whose outline is nearest to a point of the canvas, within so many pixels; of those as near, the smallest. */
  pick(x: number, y: number, reach: number, project: (point: THREE.Vector3) => [number, number, number]): { joint: number; distance: number } | null {
    const { places } = this, point = new THREE.Vector3();
    let best: { joint: number; distance: number } | null = null;
    let bestScore = reach;
    this.local.forEach((segments, control) => {
      const joint = this.actor.rig.jointCount + control;
      let nearest = Infinity;
      const end = 6 * (this.first[control] + segments.length / 6);
      for (let o = 6 * this.first[control]; o < end; o += 6) {
        const [ax, ay, ad] = project(point.set(places[o], places[o + 1], places[o + 2]));
        const [bx, by, bd] = project(point.set(places[o + 3], places[o + 4], places[o + 5]));
        if (ad === Infinity || bd === Infinity) continue;
        const length = (bx - ax) ** 2 + (by - ay) ** 2;
        const u = length > 0 ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length)) : 0;
        nearest = Math.min(nearest, Math.hypot(ax + u * (bx - ax) - x, ay + u * (by - ay) - y));
      }
      const score = nearest + 2 * Math.min(1, this.data.controls[control].size_m / 0.5);
      if (nearest < reach && score < bestScore + 2) {
        if (!best || score < bestScore) {
          bestScore = score;
          best = { joint, distance: nearest };
        }
      }
    });
    return best;
  }

  dispose(): void {
    this.lines.removeFromParent();
    this.lines.geometry.dispose();
    this.material.dispose();
  }
}
