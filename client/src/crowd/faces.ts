// Faces of the near ones: sparse morph targets, with weights of its own for every character.

import * as THREE from "three";
import type { MorphData } from "../generated/messages";
import type { Arrays } from "../net/container";

const WIDTH = 2048;

export class Faces {
  readonly uniforms: Record<string, THREE.IUniform>;
  private readonly deltas: THREE.DataTexture;
  private readonly weights: THREE.DataTexture;

  /** Sets the attribute that says which rows of the deltas move a vertex; ``weights`` has a row of ``morphs`` per character. */
  constructor(geometry: THREE.BufferGeometry, data: MorphData, arrays: Arrays, weights: Uint8Array<ArrayBuffer>, morphs: number) {
    const starts = arrays.uint32(data.starts), vertices = arrays.uint32(data.vertices);
    const moved = arrays.float32(data.position_deltas), turned = data.normal_deltas && arrays.float32(data.normal_deltas);
    const count = geometry.attributes.position.count, rows = new Float32Array(2 * count);
    for (const v of vertices) rows[2 * v + 1]++;
    for (let v = 1; v < count; v++) rows[2 * v] = rows[2 * v - 2] + rows[2 * v - 1];
    const texels = new Float32Array(4 * WIDTH * Math.max(1, Math.ceil((2 * vertices.length) / WIDTH)));
    const next = Uint32Array.from({ length: count }, (_, v) => rows[2 * v]);
    for (let target = 0; target + 1 < starts.length; target++)
      for (let n = starts[target]; n < starts[target + 1]; n++) {
        const o = 8 * next[vertices[n]]++;
        texels.set(moved.subarray(3 * n, 3 * n + 3), o);
        texels[o + 3] = target;
        if (turned) texels.set(turned.subarray(3 * n, 3 * n + 3), o + 4);
      }
    geometry.setAttribute("crowdMorphRows", new THREE.BufferAttribute(rows, 2));
    this.deltas = new THREE.DataTexture(texels, WIDTH, texels.length / (4 * WIDTH), THREE.RGBAFormat, THREE.FloatType);
    this.deltas.needsUpdate = true;
    this.weights = new THREE.DataTexture(weights, morphs, weights.length / morphs, THREE.RedFormat, THREE.UnsignedByteType);
    this.weights.unpackAlignment = 1;
    this.weights.needsUpdate = true;
    this.uniforms = { crowdMorphDeltas: { value: this.deltas }, crowdMorphWeights: { value: this.weights } };
  }

  changed(): void {
    this.weights.needsUpdate = true;
  }

  dispose(): void {
    this.deltas.dispose();
    this.weights.dispose();
  }
}

export const FACE_DECLARATIONS = /* glsl */ `
attribute vec2 crowdMorphRows;
uniform highp sampler2D crowdMorphDeltas;
uniform highp sampler2D crowdMorphWeights;
vec3 crowdMorph(int part) {
  vec3 sum = vec3(0.0);
  int row = int(crowdMorphRows.x + 0.5), end = row + int(crowdMorphRows.y + 0.5), who = int(crowdPlace.w + 0.5);
  for (; row < end; row++) {
    int at = 2 * row;
    vec4 delta = texelFetch(crowdMorphDeltas, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0);
    float weight = texelFetch(crowdMorphWeights, ivec2(int(delta.w + 0.5), who), 0).r;
    if (weight == 0.0) continue;
    if (part == 1) delta = texelFetch(crowdMorphDeltas, ivec2((at + 1) % ${WIDTH}, (at + 1) / ${WIDTH}), 0);
    sum += weight * delta.xyz;
  }
  return sum;
}
`;
