// Three lights and a small painted sky: a soft studio that flatters simple materials.

import * as THREE from "three";

export class Lights {
  readonly key = new THREE.DirectionalLight(0xfff3e2, 2.5);
  private readonly rim = new THREE.DirectionalLight(0xcfe2ff, 1.3);
  private readonly fill = new THREE.DirectionalLight(0xe8eeff, 0.35);

  constructor(scene: THREE.Scene, renderer: THREE.WebGLRenderer) {
    this.key.castShadow = true;
    this.key.shadow.mapSize.set(2048, 2048);
    this.key.shadow.radius = 3;
    this.key.shadow.bias = -0.0004;
    scene.add(this.key, this.key.target, this.rim, this.rim.target, this.fill, this.fill.target);
    scene.environment = sky(renderer);
    scene.environmentIntensity = 0.85;
  }

  fit(center: THREE.Vector3, size: number): void {
    const place = (light: THREE.DirectionalLight, x: number, y: number, z: number) => {
      light.target.position.copy(center);
      light.position.set(x, y, z).normalize().multiplyScalar(3 * size).add(center);
    };
    place(this.key, 0.75, 1.5, 1.1);
    place(this.rim, -0.9, 0.9, -1.2);
    place(this.fill, -1.2, 0.4, 0.8);
    const camera = this.key.shadow.camera;
    camera.left = camera.bottom = -1.3 * size;
    camera.right = camera.top = 1.3 * size;
    camera.near = 0.2 * size;
    camera.far = 6.5 * size;
    camera.updateProjectionMatrix();
    this.key.shadow.normalBias = 0.004 * size;
  }
}

/** A little painted panorama: bright soft boxes above, a dim floor below; prefiltered for all roughnesses. */
function sky(renderer: THREE.WebGLRenderer): THREE.Texture {
  const width = 128, height = 64;
  const data = new Float32Array(4 * width * height);
  const box = (u: number, v: number, cu: number, cv: number, ru: number, rv: number) => {
    const du = Math.min(Math.abs(u - cu), 1 - Math.abs(u - cu)) / ru, dv = Math.abs(v - cv) / rv;
    return Math.exp(-(du ** 4) - dv ** 4);
  };
  for (let y = 0; y < height; y++)
    for (let x = 0; x < width; x++) {
      const u = (x + 0.5) / width, v = (y + 0.5) / height; // v = 0 is straight down
      const up = Math.min(1, Math.max(0, (v - 0.42) / 0.5));
      const light = 2.6 * box(u, v, 0.18, 0.72, 0.09, 0.14) + 1.2 * box(u, v, 0.62, 0.66, 0.07, 0.16) + 0.9 * box(u, v, 0.9, 0.95, 0.6, 0.07);
      const o = 4 * (y * width + x);
      data[o] = 0.20 + 0.38 * up + light * 1.0;
      data[o + 1] = 0.19 + 0.42 * up + light * 0.97;
      data[o + 2] = 0.185 + 0.50 * up + light * 0.92;
      data[o + 3] = 1;
    }
  const panorama = new THREE.DataTexture(data, width, height, THREE.RGBAFormat, THREE.FloatType);
  panorama.mapping = THREE.EquirectangularReflectionMapping;
  panorama.magFilter = panorama.minFilter = THREE.LinearFilter;
  panorama.needsUpdate = true;
  const generator = new THREE.PMREMGenerator(renderer);
  const target = generator.fromEquirectangular(panorama);
  generator.dispose();
  panorama.dispose();
  return target.texture;
}
