// The floor: a soft disc with a metre grid that catches the shadows and fades into the background.

import * as THREE from "three";
import type { Palette } from "./palette";

export class Ground {
  readonly mesh: THREE.Mesh;
  private readonly uniforms = {
    floorColor: { value: new THREE.Color() },
    lineColor: { value: new THREE.Color() },
    shadowColor: { value: new THREE.Color() },
    shadowStrength: { value: 0.5 },
    center: { value: new THREE.Vector2() },
    radius: { value: 8 },
    cell: { value: 1 },
    gridShown: { value: 1 },
  };

  constructor() {
    const material = new THREE.ShadowMaterial({ transparent: true, depthWrite: false, toneMapped: false });
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.uniforms);
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nvarying vec2 groundPosition;")
        .replace("#include <worldpos_vertex>", "#include <worldpos_vertex>\ngroundPosition = (modelMatrix * vec4(transformed, 1.0)).xz;");
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          `#include <common>
          varying vec2 groundPosition;
          uniform vec3 floorColor, lineColor, shadowColor;
          uniform float shadowStrength, radius, cell, gridShown;
          uniform vec2 center;
          float grid(vec2 p, float size, float width) {
            vec2 q = p / size;
            vec2 d = fwidth(q);
            vec2 g = abs(fract(q - 0.5) - 0.5) / max(d, vec2(1e-6));
            float line = 1.0 - min(min(g.x, g.y) / width, 1.0);
            return line * (1.0 - smoothstep(0.15, 0.5, max(d.x, d.y)));
          }`,
        )
        .replace(
          "gl_FragColor = vec4( color, opacity * ( 1.0 - getShadowMask() ) );",
          `float away = length(groundPosition - center) / radius;
          float fade = 1.0 - smoothstep(0.15, 1.0, away);
          float lines = gridShown * max(0.75 * grid(groundPosition, cell, 1.3), 0.28 * grid(groundPosition, cell * 0.2, 1.0));
          vec3 tint = mix(floorColor, lineColor, lines);
          float shade = shadowStrength * (1.0 - getShadowMask());
          gl_FragColor = vec4(mix(tint, shadowColor, shade), fade * max(0.82, shade));`,
        );
    };
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(2, 2).rotateX(-Math.PI / 2), material);
    this.mesh.receiveShadow = true;
    this.mesh.renderOrder = -10;
    this.mesh.frustumCulled = false;
  }

  paint(palette: Palette): void {
    this.uniforms.floorColor.value.copy(palette.floor);
    this.uniforms.lineColor.value.copy(palette.line);
    this.uniforms.shadowColor.value.copy(palette.shadow);
    this.uniforms.shadowStrength.value = palette.shadowStrength;
  }

  set grid(shown: boolean) {
    this.uniforms.gridShown.value = shown ? 1 : 0;
  }

  /** Lie under what is on the stage. */
  fit(center: THREE.Vector3, size: number): void {
    const radius = 4.5 * size;
    this.uniforms.center.value.set(center.x, center.z);
    this.uniforms.radius.value = radius;
    // one metre for a person; ten times as much or as little for giants and mice
    this.uniforms.cell.value = 10 ** Math.round(Math.log10(size / 2));
    this.mesh.position.set(center.x, 0, center.z);
    this.mesh.scale.set(radius, 1, radius);
  }
}
