// Where the contacts came down: soft marks on the ground that fade, so that travel and sliding feet are seen.

import * as THREE from "three";

/** GLSL: 1 inside of a print, a sole and a heel; `at` is -1 to 1 over its width and length. */
export const PRINT_SHAPE = `
  float printShape(vec2 at) {
    float sole = length((at - vec2(0.0, -0.34)) / vec2(0.78, 0.62));
    float heel = length((at - vec2(0.0, 0.66)) / vec2(0.6, 0.32));
    return 1.0 - smoothstep(0.86, 1.0, min(sole, heel));
  }`;

const COUNT = 64;
const LIFE_S = 9;

export class Footprints {
  readonly mesh: THREE.InstancedMesh;
  private readonly born = new Float32Array(COUNT).fill(-1e6);
  private readonly bornAttribute = new THREE.InstancedBufferAttribute(this.born, 1);
  private readonly uniforms = { now: { value: 0 }, color: { value: new THREE.Color() }, strength: { value: 0.55 } };
  private next = 0;
  private readonly matrix = new THREE.Matrix4();
  private readonly turn = new THREE.Quaternion();
  private readonly scale = new THREE.Vector3();
  private readonly place = new THREE.Vector3();
  private static readonly UP = new THREE.Vector3(0, 1, 0);

  constructor() {
    const geometry = new THREE.PlaneGeometry(1, 1).rotateX(-Math.PI / 2);
    geometry.setAttribute("born", this.bornAttribute);
    const material = new THREE.ShaderMaterial({
      uniforms: this.uniforms,
      transparent: true,
      depthWrite: false,
      toneMapped: false,
      vertexShader: `
        attribute float born;
        uniform float now;
        varying vec2 at;
        varying float life;
        void main() {
          at = uv * 2.0 - 1.0;
          life = clamp(1.0 - (now - born) / ${LIFE_S.toFixed(1)}, 0.0, 1.0) * step(0.0, now - born + 0.5);
          gl_Position = projectionMatrix * modelViewMatrix * instanceMatrix * vec4(position, 1.0);
        }`,
      fragmentShader: `
        uniform vec3 color;
        uniform float strength;
        varying vec2 at;
        varying float life;
        ${PRINT_SHAPE}
        void main() {
          gl_FragColor = vec4(color, printShape(at) * life * strength);
          if (gl_FragColor.a < 0.004) discard;
        }`,
    });
    this.mesh = new THREE.InstancedMesh(geometry, material, COUNT);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -5;
  }

  paint(color: THREE.Color, strength: number): void {
    this.uniforms.color.value.copy(color);
    this.uniforms.strength.value = strength;
  }

  stamp(x: number, z: number, yaw: number, length: number, now: number): void {
    this.turn.setFromAxisAngle(Footprints.UP, yaw);
    this.matrix.compose(this.place.set(x, 0.004, z), this.turn, this.scale.set(0.42 * length, 1, length));
    this.mesh.setMatrixAt(this.next, this.matrix);
    this.born[this.next] = now;
    this.next = (this.next + 1) % COUNT;
    this.mesh.instanceMatrix.needsUpdate = this.bornAttribute.needsUpdate = true;
  }

  at(now: number): void {
    this.uniforms.now.value = now;
  }

  clear(): void {
    this.born.fill(-1e6);
    this.bornAttribute.needsUpdate = true;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    (this.mesh.material as THREE.Material).dispose();
    this.mesh.dispose();
  }
}
