// Where and when the feet of one character touch the ground: a print for each contact, lit while it lasts, its colour how
// fast the foot slides on it.

import * as THREE from "three";
import { Pose } from "../anim/rig";
import { PRINT_SHAPE } from "../play/footprints";
import type { Actor } from "../view/actor";

/** From standing still to sliding, in cm/s for a leg of a person. */
export const STILL = 1, SLIDING = 8;

/** The steps of a foot as first and last frames in pairs, how they slide, and the joints of its ankle and ball. */
export interface Foot {
  side: "left" | "right";
  joints: readonly string[];
  steps: readonly number[];
  slides: readonly number[];
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

  /** The prints of a character's steps in the animation that it performs now. */
  fit(actor: Actor, feet: readonly Foot[], start: number, rate: number): void {
    const pose = new Pose(actor.rig.count, actor.morphNames.length), world = new Float64Array(12 * actor.rig.count);
    const back = new THREE.Vector3(), tip = new THREE.Vector3(), place = new THREE.Vector3(), scale = new THREE.Vector3();
    const turn = new THREE.Quaternion(), up = new THREE.Vector3(0, 1, 0);
    const found: { print: Print; matrix: THREE.Matrix4 }[] = [];
    for (const { side, joints, steps, slides } of feet) {
      const [ankle, ball] = joints.map((joint) => actor.rig.index(joint));
      if (ankle === undefined || ankle < 0) continue;
      slides.forEach((slide, n) => {
        const first = steps[2 * n], last = steps[2 * n + 1];
        // where the foot stands in the middle of its step
        actor.evaluate(start + Math.round((first + last) / 2) / rate, pose, world);
        actor.jointPosition(ankle, back, world);
        actor.jointPosition(ball, tip, world);
        const length = ball === ankle ? 0.12 * actor.height : 2.05 * back.distanceTo(tip);
        const o = 12 * ankle;
        const yaw = ball === ankle ? Math.atan2(world[o + 6], world[o + 8]) : Math.atan2(tip.x - back.x, tip.z - back.z);
        // a print reaches from behind the ankle to before the ball
        place.set(0.5 * (back.x + tip.x) + 0.12 * length * Math.sin(yaw), 0.002 * actor.height, 0.5 * (back.z + tip.z) + 0.12 * length * Math.cos(yaw));
        turn.setFromAxisAngle(up, yaw + Math.PI);
        const matrix = new THREE.Matrix4().compose(place, turn, scale.set(0.42 * length, 1, 1.12 * length));
        found.push({ print: { from: start + first / rate, to: start + (last + 1) / rate, side, slide }, matrix });
      });
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
