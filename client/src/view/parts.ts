// The meshes of a character: geometry from the payload, skinned and morphed by the shader.

import * as THREE from "three";
import type { PartData, SkinData } from "../generated/messages";
import { writePalette } from "../anim/rig";
import type { Arrays } from "../net/container";
import { surface } from "./materials";
import { MorphWeights, SparseMorphs } from "./sparse-morphs";

/** Joint matrices of one skin, written straight from the rig; three.js' own bones are not used. */
export class PaletteSkeleton extends THREE.Skeleton {
  constructor(
    readonly palette: Int32Array,
    readonly inverse: Float32Array,
  ) {
    super([], []);
    this.computeBoneTexture();
  }

  override computeBoneTexture(): this {
    const size = Math.max(4, Math.ceil(Math.sqrt(this.palette.length * 4) / 4) * 4);
    this.boneMatrices = new Float32Array(size * size * 4);
    this.boneTexture = new THREE.DataTexture(this.boneMatrices, size, size, THREE.RGBAFormat, THREE.FloatType);
    this.boneTexture.needsUpdate = true;
    return this;
  }

  override update(): void {
    // three.js calls this before drawing; the matrices are already there
  }

  write(world: Float64Array): void {
    writePalette(world, this.palette, this.inverse, this.boneMatrices as Float32Array);
    this.boneTexture!.needsUpdate = true;
  }
}

/** What stays the same for the character and all its ghosts. */
export interface PartSource {
  readonly data: PartData;
  readonly geometry: THREE.BufferGeometry;
  readonly material: THREE.Material;
  readonly skin: { palette: Int32Array; inverse: Float32Array; key: number } | null;
  readonly morphs: SparseMorphs | null;
}

export function partSources(
  parts: PartData[],
  arrays: Arrays,
  textures: (THREE.Texture | null)[],
): PartSource[] {
  return parts.map((data) => {
    const geometry = buildGeometry(data, arrays);
    const texture = data.material.image === null ? null : textures[data.material.image];
    return {
      data,
      geometry,
      material: surface(data.material, data.uvs ? texture : null, data.colors !== null),
      skin: data.skin && {
        palette: arrays.int32(data.skin.palette),
        inverse: arrays.float32(data.skin.joint_from_mesh),
        key: data.skin.palette.offset,
      },
      morphs: data.morphs && new SparseMorphs(geometry, data.morphs, arrays),
    };
  });
}

function buildGeometry(data: PartData, arrays: Arrays): THREE.BufferGeometry {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(arrays.float32(data.positions), 3));
  geometry.setIndex(new THREE.BufferAttribute(arrays.uint32(data.triangles), 1));
  if (data.uvs) geometry.setAttribute("uv", new THREE.BufferAttribute(arrays.float32(data.uvs), 2));
  if (data.colors) geometry.setAttribute("color", new THREE.BufferAttribute(arrays.float32(data.colors), 4));
  if (data.normals) geometry.setAttribute("normal", new THREE.BufferAttribute(arrays.float32(data.normals), 3));
  else geometry.computeVertexNormals();
  if (data.skin) addSkin(geometry, data.skin, arrays);
  return geometry;
}

function addSkin(geometry: THREE.BufferGeometry, skin: SkinData, arrays: Arrays): void {
  geometry.setAttribute("skinIndex", new THREE.BufferAttribute(arrays.uint16(skin.joints), 4));
  geometry.setAttribute("skinWeight", new THREE.BufferAttribute(arrays.float32(skin.weights), 4));
}

export type PartMesh = THREE.Mesh;

/** One drawn body: the character itself, or one of its ghosts. */
export class Body {
  readonly group = new THREE.Group();
  readonly meshes: PartMesh[] = [];
  readonly skeletons: PaletteSkeleton[] = [];
  readonly weights: MorphWeights;

  /** `materials` are the layers of a part, drawn one over the other. */
  constructor(
    readonly sources: PartSource[],
    morphs: number,
    materials: (source: PartSource) => THREE.Material[],
  ) {
    this.weights = new MorphWeights(morphs);
    const bySkin = new Map<number, PaletteSkeleton>();
    for (const source of sources) {
      for (const [layer, material] of materials(source).entries()) {
        const mesh = this.mesh(source, this.taught(source, material), bySkin);
        if (source.morphs) mesh.customDepthMaterial = this.taught(source, new THREE.MeshDepthMaterial({ side: THREE.DoubleSide }));
        mesh.name = source.data.name;
        mesh.frustumCulled = false; // the shader moves the vertices
        mesh.matrixAutoUpdate = false;
        mesh.renderOrder = layer;
        mesh.userData.source = source;
        this.meshes.push(mesh);
        this.group.add(mesh);
      }
    }
    this.skeletons = [...bySkin.values()];
  }

  private mesh(source: PartSource, material: THREE.Material, bySkin: Map<number, PaletteSkeleton>): PartMesh {
    if (!source.skin) return new THREE.Mesh(source.geometry, material);
    const mesh = new THREE.SkinnedMesh(source.geometry, material);
    let skeleton = bySkin.get(source.skin.key);
    if (!skeleton) {
      skeleton = new PaletteSkeleton(source.skin.palette, source.skin.inverse);
      bySkin.set(source.skin.key, skeleton);
    }
    // three.js would ask its own bones for the bounds, to sort what is transparent
    source.geometry.computeBoundingSphere();
    mesh.boundingSphere = source.geometry.boundingSphere!;
    mesh.bindMode = THREE.DetachedBindMode;
    mesh.bind(skeleton, new THREE.Matrix4());
    return mesh;
  }

  /** A material of this body for a part: where the part morphs, one that morphs with this body's weights. */
  taught<M extends THREE.Material>(source: PartSource, material: M): M {
    return source.morphs ? source.morphs.teach(material, this.weights) : material;
  }

  /** Hand a solved pose to the shaders. */
  write(world: Float64Array, morphs: Float64Array): void {
    for (let n = 0; n < this.skeletons.length; n++) this.skeletons[n].write(world);
    for (let n = 0; n < this.meshes.length; n++) {
      const mesh = this.meshes[n];
      const source = mesh.userData.source as PartSource;
      const joint = source.data.joint;
      if (joint !== null) {
        const e = mesh.matrix.elements, o = 12 * joint;
        e[0] = world[o]; e[1] = world[o + 1]; e[2] = world[o + 2];
        e[4] = world[o + 3]; e[5] = world[o + 4]; e[6] = world[o + 5];
        e[8] = world[o + 6]; e[9] = world[o + 7]; e[10] = world[o + 8];
        e[12] = world[o + 9]; e[13] = world[o + 10]; e[14] = world[o + 11];
        mesh.matrixWorldNeedsUpdate = true;
      }
    }
    this.weights.write(morphs);
  }

  dispose(): void {
    this.group.removeFromParent();
    for (const skeleton of this.skeletons) skeleton.dispose();
    for (const mesh of this.meshes) mesh.customDepthMaterial?.dispose();
    this.weights.dispose();
  }
}

/** Vertex positions after morphing and skinning, computed on the processor: what the shader must show. */
export function deformedVertices(source: PartSource, world: Float64Array, morphs: Float64Array): Float32Array {
  const base = source.geometry.attributes.position.array as Float32Array;
  const local = Float64Array.from(base);
  source.morphs?.apply(local, morphs);
  const out = new Float32Array(base.length);
  const joint = source.data.joint;
  const matrices = new Float32Array(16 * (source.skin?.palette.length ?? 0));
  if (source.skin) writePalette(world, source.skin.palette, source.skin.inverse, matrices);
  const joints = source.geometry.attributes.skinIndex?.array;
  const weights = source.geometry.attributes.skinWeight?.array;
  for (let v = 0; v < base.length / 3; v++) {
    const x = local[3 * v], y = local[3 * v + 1], z = local[3 * v + 2];
    for (let c = 0; c < 3; c++) {
      if (joint !== null) {
        const o = 12 * joint + c;
        out[3 * v + c] = world[o] * x + world[o + 3] * y + world[o + 6] * z + world[o + 9];
        continue;
      }
      let sum = 0;
      for (let k = 0; k < 4; k++) {
        const w = weights[4 * v + k], m = 16 * joints[4 * v + k] + c;
        if (w !== 0) sum += w * (matrices[m] * x + matrices[m + 4] * y + matrices[m + 8] * z + matrices[m + 12]);
      }
      out[3 * v + c] = sum;
    }
  }
  return out;
}
