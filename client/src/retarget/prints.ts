// Where and when the feet of one character touch the ground: a print for each contact, lit while it lasts, its colour how
// fast the foot slides on it.

import * as THREE from "three";
import { Pose } from "../anim/rig";
import { PRINT_SHAPE } from "../play/footprints";
import type { Actor } from "../view/actor";

/** From standing still to sliding, in cm/s for a leg of a person. */
export const STILL = 1, SLIDING = 8;

/** When a point of a foot is on the ground, as first and last frames in pairs, and the joint that stands for it. */
export interface Contact {
  point: string;
  joint: string;
  spans: readonly number[];
}

export interface Print {
  from: number;
  to: number;
  side: "left" | "right";
  /** Mean speed of the carrying point over the ground, cm/s. */
  slide: number;
}

const MOST = 400;

export class Prints {
  readonly group = new THREE.Group();
  prints: Print[] = [];
  private readonly mesh: THREE.InstancedMesh;
  private readonly span: THREE.InstancedBufferAttribute;
  private readonly slide: THREE.InstancedBufferAttribute;
  private readonly uniforms = {
    now: { value: 0 },
    still: { value: new THREE.Color() },
    sliding: { value: new THREE.Color() },
    strength: { value: 0.9 },
  };

  constructor() {
    const geometry = new THREE.PlaneGeometry(1, 1).rotateX(-Math.PI / 2);
    this.span = new THREE.InstancedBufferAttribute(new Float32Array(2 * MOST), 2);
    this.slide = new THREE.InstancedBufferAttribute(new Float32Array(MOST), 1);
    geometry.setAttribute("span", this.span);
    geometry.setAttribute("slide", this.slide);
    const material = new THREE.ShaderMaterial({
      uniforms: this.uniforms,
      transparent: true,
      depthWrite: false,
      toneMapped: false,
      vertexShader: `
        attribute vec2 span;
        attribute float slide;
        uniform float now;
        varying vec2 at;
        varying float shown, sliding01;
        void main() {
          at = uv * 2.0 - 1.0;
          float age = now - span.y;
          shown = step(span.x, now) * (age < 0.0 ? 1.0 : mix(0.42, 0.12, clamp(age / 6.0, 0.0, 1.0)));
          sliding01 = slide;
          gl_Position = projectionMatrix * modelViewMatrix * instanceMatrix * vec4(position, 1.0);
        }`,
      fragmentShader: `
        uniform vec3 still, sliding;
        uniform float strength;
        varying vec2 at;
        varying float shown, sliding01;
        ${PRINT_SHAPE}
        void main() {
          gl_FragColor = vec4(mix(still, sliding, sliding01), printShape(at) * shown * strength);
          if (gl_FragColor.a < 0.004) discard;
          #include <colorspace_fragment>
        }`,
    });
    this.mesh = new THREE.InstancedMesh(geometry, material, MOST);
    this.mesh.count = 0;
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -5;
    this.group.add(this.mesh);
  }

  /** Find the prints of a character's contacts in the animation that it performs now. */
  fit(actor: Actor, contacts: readonly Contact[], start: number, rate: number): void {
    const pose = new Pose(actor.rig.count, actor.morphNames.length), world = new Float64Array(12 * actor.rig.count);
    const back = new THREE.Vector3(), tip = new THREE.Vector3(), last = new THREE.Vector3();
    const turn = new THREE.Quaternion(), up = new THREE.Vector3(0, 1, 0), matrix = new THREE.Matrix4();
    const found: { print: Print; matrix: THREE.Matrix4 }[] = [];
    for (const side of ["left", "right"] as const) {
      const jointOf = (point: string) => {
        const contact = contacts.find((c) => c.point === `${side}_${point}`);
        return contact ? { joint: actor.rig.index(contact.joint), spans: contact.spans } : null;
      };
      const ball = jointOf("ball"), balls = ball && ball.joint >= 0 ? ball : null;
      const heels = jointOf("heel") ?? balls;
      if (!heels || heels.joint < 0) continue;
      const front = balls ? balls.joint : heels.joint;
      const down = (part: typeof heels, frame: number) => part !== null && within(part.spans, frame);
      for (const [first, final] of joined([...pairs(heels.spans), ...(balls ? pairs(balls.spans) : [])])) {
        // where the foot stands in the middle of its contact, and how far its carrying point goes meanwhile
        let way = 0, steps = 0, carried = -1;
        const every = Math.max(1, Math.floor((final - first) / 40));
        for (let frame = first; frame <= final; frame += every) {
          actor.evaluate(start + frame / rate, pose, world);
          const carrier = balls && down(balls, frame) ? front : heels.joint;
          actor.jointPosition(carrier, tip, world).setY(0);
          if (carrier === carried) {
            way += tip.distanceTo(last);
            steps += every;
          }
          carried = carrier;
          last.copy(tip);
        }
        const slide = steps > 0 ? (100 * way * rate) / steps : 0;
        actor.evaluate(start + Math.round((first + final) / 2) / rate, pose, world);
        actor.jointPosition(heels.joint, back, world);
        actor.jointPosition(front, tip, world);
        const length = 0.15 * actor.height;
        let yaw = Math.atan2(tip.x - back.x, tip.z - back.z);
        if (front === heels.joint) {
          const o = 12 * heels.joint;
          yaw = Math.atan2(world[o + 6], world[o + 8]);
        }
        // a print reaches from behind the ankle to before the ball
        const x = 0.5 * (back.x + tip.x) + 0.12 * length * Math.sin(yaw), z = 0.5 * (back.z + tip.z) + 0.12 * length * Math.cos(yaw);
        turn.setFromAxisAngle(up, yaw + Math.PI);
        matrix.compose(new THREE.Vector3(x, 0.004 * actor.height, z), turn, new THREE.Vector3(0.42 * length, 1, 1.12 * length));
        found.push({ print: { from: start + first / rate, to: start + (final + 1) / rate, side, slide }, matrix: matrix.clone() });
      }
    }
    found.sort((a, b) => a.print.from - b.print.from);
    this.prints = found.map(({ print }) => print);
    this.mesh.count = Math.min(MOST, found.length);
    found.slice(0, MOST).forEach(({ print, matrix }, n) => {
      this.mesh.setMatrixAt(n, matrix);
      this.span.setXY(n, print.from, print.to);
      this.slide.setX(n, Math.max(0, Math.min(1, (print.slide - STILL) / (SLIDING - STILL))));
    });
    this.mesh.instanceMatrix.needsUpdate = this.span.needsUpdate = this.slide.needsUpdate = true;
  }

  paint(still: string, sliding: string, strength: number): void {
    this.uniforms.still.value.set(still);
    this.uniforms.sliding.value.set(sliding);
    this.uniforms.strength.value = strength;
  }

  at(now: number): void {
    this.uniforms.now.value = now;
  }

  dispose(): void {
    this.group.removeFromParent();
    this.mesh.geometry.dispose();
    (this.mesh.material as THREE.Material).dispose();
    this.mesh.dispose();
  }
}

const pairs = (spans: readonly number[]): [number, number][] => Array.from({ length: spans.length / 2 }, (_, n) => [spans[2 * n], spans[2 * n + 1]]);

function within(spans: readonly number[], frame: number): boolean {
  for (let n = 0; n < spans.length; n += 2) if (spans[n] <= frame && frame <= spans[n + 1]) return true;
  return false;
}

/** Spans that touch or overlap as one. */
export function joined(spans: readonly (readonly [number, number])[]): [number, number][] {
  const found: [number, number][] = [];
  for (const [from, to] of [...spans].sort((a, b) => a[0] - b[0])) {
    const last = found.at(-1);
    if (last && from <= last[1] + 1) last[1] = Math.max(last[1], to);
    else found.push([from, to]);
  }
  return found;
}
