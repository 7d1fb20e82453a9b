// The onion skin: the same character some frames before and after.

import * as THREE from "three";
import { Pose } from "../anim/rig";
import type { Actor } from "./actor";
import { ghostDepthMaterial, ghostMaterial } from "./materials";
import type { Palette } from "./palette";
import { Body } from "./parts";
import { Sticks } from "./sticks";

export interface GhostSettings {
  before: number;
  after: number;
  /** Frames between one ghost and the next. */
  step: number;
  /** Times of keys in seconds, ascending: the ghosts stand there instead of in even steps. */
  keys?: Float64Array | null;
}

interface Ghost {
  /** Its place: the n-th before (negative) or after. */
  place: number;
  time: number;
  body: Body | null;
  sticks: Sticks | null;
}

export class Ghosts {
  readonly group = new THREE.Group();
  private readonly ghosts: Ghost[] = [];
  private readonly pose: Pose;
  private readonly world: Float64Array;
  private readonly materials: THREE.Material[] = [];

  constructor(
    actor: Actor,
    private readonly settings: GhostSettings,
    palette: Palette,
  ) {
    this.pose = actor.rig.newPose();
    this.world = new Float64Array(12 * actor.rig.count);
    const behind = 0.05 * actor.height;
    const plainDepth = this.keep(ghostDepthMaterial(behind));
    const add = (place: number, color: THREE.Color, strength: number, order: number) => {
      const plain = this.keep(ghostMaterial(color, strength, behind));
      const ghost: Ghost = { place, time: NaN, body: null, sticks: null };
      if (actor.hasMesh) {
        ghost.body = new Body(actor.sources, actor.morphNames.length, (source) =>
          // parts that morph need materials of their own, because these hold the weights
          source.morphs ? [this.keep(ghostDepthMaterial(behind)), this.keep(ghostMaterial(color, strength, behind))] : [plainDepth, plain],
        );
        // each ghost lays down its depth before its colour, the furthest in time first
        for (const mesh of ghost.body.meshes) mesh.renderOrder += 10 + 2 * order;
        this.group.add(ghost.body.group);
      } else {
        ghost.sticks = new Sticks(actor.rig, color, strength);
        this.group.add(ghost.sticks.lines);
      }
      this.ghosts.push(ghost);
    };
    for (let n = settings.before; n >= 1; n--)
      add(-n, palette.ghostBefore, 0.75 * (1 - (n - 1) / (settings.before + 1)), settings.before - n);
    for (let n = settings.after; n >= 1; n--)
      add(n, palette.ghostAfter, 0.75 * (1 - (n - 1) / (settings.after + 1)), settings.after - n);
  }

  private keep<M extends THREE.Material>(material: M): M {
    this.materials.push(material);
    return material;
  }

  update(actor: Actor, time: number): void {
    const { animation } = actor;
    if (!animation) return;
    for (const ghost of this.ghosts) {
      const at = this.timeOf(ghost.place, time, animation.rate);
      const visible = at >= animation.start - 1e-6 && at <= animation.end + 1e-6;
      if (ghost.body) ghost.body.group.visible = visible;
      if (ghost.sticks) ghost.sticks.lines.visible = visible;
      ghost.time = visible ? at : NaN;
      if (!visible) continue;
      actor.evaluate(at, this.pose, this.world);
      ghost.body?.write(this.world, this.pose.morphs);
      ghost.sticks?.write(this.world);
    }
  }

  times(): number[] {
    return this.ghosts.map((ghost) => ghost.time).filter((time) => time === time);
  }

  /** When the n-th ghost stands; NaN where there is no such key. */
  private timeOf(place: number, time: number, rate: number): number {
    const { keys, step } = this.settings;
    if (!keys) return time + (place * step) / rate;
    const before = keys.findIndex((t) => t > time - 1e-6);
    const next = before < 0 ? keys.length : before;
    const after = next < keys.length && keys[next] < time + 1e-6 ? next + 1 : next;
    return keys[place < 0 ? next + place : after + place - 1] ?? NaN;
  }

  dispose(): void {
    this.group.removeFromParent();
    for (const ghost of this.ghosts) {
      ghost.body?.dispose();
      ghost.sticks?.dispose();
    }
    for (const material of this.materials) material.dispose();
  }
}
