// Morph targets in the vertex shader, sparse: each vertex looks up only the targets that move it.
//
// three.js keeps dense targets and builds another shader program for every number of them. Here one texture holds the
// deltas sorted by vertex, an attribute says which rows belong to a vertex, and another texture holds the weights: one
// program for every character, no limit on the number of targets, and memory only for what moves.

import * as THREE from "three";
import type { MorphData } from "../generated/messages";
import type { Arrays } from "../net/container";

const WIDTH = 2048;
const WEIGHTS_WIDTH = 1024;

/** The deltas of one part, shared by the character and its ghosts. */
export class SparseMorphs {
  readonly channels: Int32Array;
  private readonly starts: Uint32Array;
  private readonly vertices: Uint32Array;
  private readonly deltas: Float32Array;
  private readonly texture: THREE.DataTexture;

  constructor(geometry: THREE.BufferGeometry, data: MorphData, arrays: Arrays) {
    this.channels = arrays.int32(data.channels);
    this.starts = arrays.uint32(data.starts);
    this.vertices = arrays.uint32(data.vertices);
    this.deltas = arrays.float32(data.position_deltas);
    const normals = data.normal_deltas && arrays.float32(data.normal_deltas);
    const count = geometry.attributes.position.count;
    // rows of a vertex: first row and how many
    const rows = new Uint32Array(2 * count);
    for (const v of this.vertices) rows[2 * v + 1]++;
    for (let v = 1; v < count; v++) rows[2 * v] = rows[2 * v - 2] + rows[2 * v - 1];
    const texels = new Float32Array(4 * WIDTH * Math.max(1, Math.ceil((2 * this.vertices.length) / WIDTH)));
    const next = Uint32Array.from({ length: count }, (_, v) => rows[2 * v]);
    for (let target = 0; target + 1 < this.starts.length; target++)
      for (let n = this.starts[target]; n < this.starts[target + 1]; n++) {
        const o = 8 * next[this.vertices[n]]++;
        texels.set(this.deltas.subarray(3 * n, 3 * n + 3), o);
        texels[o + 3] = this.channels[target];
        if (normals) texels.set(normals.subarray(3 * n, 3 * n + 3), o + 4);
      }
    geometry.setAttribute("morphRows", new THREE.Float32BufferAttribute(Float32Array.from(rows), 2));
    this.texture = new THREE.DataTexture(texels, WIDTH, texels.length / (4 * WIDTH), THREE.RGBAFormat, THREE.FloatType);
    this.texture.needsUpdate = true;
  }

  /** Teach a material to morph; its program is shared by all that were taught so. */
  teach<M extends THREE.Material>(material: M, weights: MorphWeights): M {
    const before = material.onBeforeCompile.bind(material);
    const key = material.customProgramCacheKey.bind(material);
    material.onBeforeCompile = (shader, renderer) => {
      before(shader, renderer);
      shader.uniforms.morphDeltas = { value: this.texture };
      shader.uniforms.morphWeights = { value: weights.texture };
      shader.vertexShader = MORPH_DECLARATIONS + shader.vertexShader
        .replace("#include <morphnormal_vertex>", MORPH_NORMAL)
        .replace("#include <morphtarget_vertex>", MORPH_POSITION);
    };
    const known = key();
    material.customProgramCacheKey = () => `${known} sparse-morphs`;
    return material;
  }

  /** The same sums on the processor, for measuring and tests. */
  apply(positions: Float64Array, weights: ArrayLike<number>): void {
    for (let target = 0; target + 1 < this.starts.length; target++) {
      const weight = weights[this.channels[target]];
      if (weight === 0) continue;
      for (let n = this.starts[target]; n < this.starts[target + 1]; n++)
        for (let c = 0; c < 3; c++) positions[3 * this.vertices[n] + c] += weight * this.deltas[3 * n + c];
    }
  }

  dispose(): void {
    this.texture.dispose();
  }
}

/** The weights of all morph channels of one body. */
export class MorphWeights {
  readonly texture: THREE.DataTexture;
  private readonly values: Float32Array;

  constructor(channels: number) {
    const height = Math.max(1, Math.ceil(channels / WEIGHTS_WIDTH));
    this.values = new Float32Array(WEIGHTS_WIDTH * height);
    this.texture = new THREE.DataTexture(this.values, WEIGHTS_WIDTH, height, THREE.RedFormat, THREE.FloatType);
    this.texture.needsUpdate = true;
  }

  write(weights: Float64Array): void {
    let changed = false;
    for (let m = 0; m < weights.length; m++) {
      const value = Math.fround(weights[m]);
      if (this.values[m] !== value) {
        this.values[m] = value;
        changed = true;
      }
    }
    if (changed) this.texture.needsUpdate = true;
  }

  dispose(): void {
    this.texture.dispose();
  }
}

const MORPH_DECLARATIONS = /* glsl */ `
attribute vec2 morphRows;
uniform highp sampler2D morphDeltas;
uniform highp sampler2D morphWeights;
vec3 sparseMorph(int part) {
  vec3 sum = vec3(0.0);
  int row = int(morphRows.x), end = row + int(morphRows.y);
  for (; row < end; row++) {
    int at = 2 * row;
    vec4 delta = texelFetch(morphDeltas, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0);
    int channel = int(delta.w);
    float weight = texelFetch(morphWeights, ivec2(channel % ${WEIGHTS_WIDTH}, channel / ${WEIGHTS_WIDTH}), 0).r;
    if (weight == 0.0) continue;
    if (part == 1) delta = texelFetch(morphDeltas, ivec2((at + 1) % ${WIDTH}, (at + 1) / ${WIDTH}), 0);
    sum += weight * delta.xyz;
  }
  return sum;
}
`;
const MORPH_NORMAL = "objectNormal += sparseMorph(1);";
const MORPH_POSITION = "transformed += sparseMorph(0);";
