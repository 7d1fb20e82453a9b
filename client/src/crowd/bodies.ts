// The crowd as it is drawn: one mesh per level of detail, one instance per character, skinned from a texture of matrices.

import * as THREE from "three";
import type { CrowdLevel, CrowdReady } from "../generated/messages";
import { Arrays, type Container } from "../net/container";
import { FACE_DECLARATIONS, Faces } from "./faces";
import type { Population } from "./population";

export const MOST_MATERIALS = 32;
export const LEVEL_COLORS = [0xffb020, 0x36b37e, 0x3b82f6, 0xa46bf5];

const DECLARATIONS = /* glsl */ `
attribute vec4 crowdJoints;
attribute vec4 crowdWeights;
attribute vec4 crowdPlace; // x, z, yaw, character
attribute vec3 crowdRows; // newest row, the one before, share of the way
uniform highp isampler2D crowdMatrices;
uniform float crowdUnit;
vec4 crowdX, crowdY, crowdZ;
vec4 crowdRow(int x, int y) {
  return vec4(texelFetch(crowdMatrices, ivec2(x, y), 0)) * vec4(vec3(1.0 / 16384.0), crowdUnit);
}
void crowdAdd(float weight, float joint) {
  if (weight <= 0.0) return;
  int x = 3 * int(joint + 0.5), now = int(crowdRows.x + 0.5), before = int(crowdRows.y + 0.5);
  float share = weight * crowdRows.z;
  crowdX += share * crowdRow(x, now); crowdY += share * crowdRow(x + 1, now); crowdZ += share * crowdRow(x + 2, now);
  share = weight - share;
  if (share <= 0.0) return;
  crowdX += share * crowdRow(x, before); crowdY += share * crowdRow(x + 1, before); crowdZ += share * crowdRow(x + 2, before);
}
vec3 crowdTurned(vec3 v) {
  float s = sin(crowdPlace.z), c = cos(crowdPlace.z);
  return vec3(c * v.x + s * v.z, v.y, c * v.z - s * v.x);
}
`;
const MOVE = /* glsl */ `
  crowdX = crowdY = crowdZ = vec4(0.0);
  crowdAdd(crowdWeights.x, crowdJoints.x);
  crowdAdd(crowdWeights.y, crowdJoints.y);
  crowdAdd(crowdWeights.z, crowdJoints.z);
  crowdAdd(crowdWeights.w, crowdJoints.w);
`;
const POSITION = /* glsl */ `
  vec4 crowdPoint = vec4(position CROWD_MOVED, 1.0);
  vec3 transformed = crowdTurned(vec3(dot(crowdX, crowdPoint), dot(crowdY, crowdPoint), dot(crowdZ, crowdPoint)));
  transformed.xz += crowdPlace.xy;
`;
const NORMAL = /* glsl */ `
  vec3 crowdNormal = normal CROWD_TURNED;
  vec3 objectNormal = crowdTurned(vec3(dot(crowdX.xyz, crowdNormal), dot(crowdY.xyz, crowdNormal), dot(crowdZ.xyz, crowdNormal)));
`;

interface Shared {
  matrices: { value: THREE.DataTexture };
  unit: { value: number };
  colors: { value: THREE.DataTexture };
  surfaces: { value: THREE.Vector3[] };
  glow: { value: number };
}

function moving<M extends THREE.Material>(
  material: M,
  shared: Shared,
  faces: Faces | null,
  more: (shader: THREE.WebGLProgramParametersWithUniforms) => void,
  key: string,
): M {
  const macros = faces
    ? `${FACE_DECLARATIONS}\n#define CROWD_MOVED + crowdMorph(0)\n#define CROWD_TURNED + crowdMorph(1)`
    : "#define CROWD_MOVED\n#define CROWD_TURNED";
  material.onBeforeCompile = (shader) => {
    if (faces) Object.assign(shader.uniforms, faces.uniforms);
    shader.uniforms.crowdMatrices = shared.matrices;
    shader.uniforms.crowdUnit = shared.unit;
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", `#include <common>\n${DECLARATIONS}\n${macros}`)
      .replace("void main() {", `void main() {\n${MOVE}`)
      .replace("#include <beginnormal_vertex>", NORMAL)
      .replace("#include <begin_vertex>", POSITION);
    more(shader);
  };
  material.customProgramCacheKey = () => `crowd ${key} ${faces !== null}`;
  return material;
}

function surface(shared: Shared, faces: Faces | null, tint: { value: THREE.Vector4 }): THREE.MeshStandardMaterial {
  const made = new THREE.MeshStandardMaterial({ shadowSide: THREE.BackSide });
  return moving(
    made,
    shared,
    faces,
    (shader) => {
      shader.uniforms.crowdColors = shared.colors;
      shader.uniforms.crowdSurfaces = shared.surfaces;
      shader.uniforms.crowdTint = tint;
      shader.uniforms.crowdGlow = shared.glow;
      shader.vertexShader = shader.vertexShader
        .replace(
          "#include <common>",
          `#include <common>
          attribute vec4 crowdShade; // shade, material
          uniform sampler2D crowdColors;
          uniform vec3 crowdSurfaces[${MOST_MATERIALS}];
          uniform vec4 crowdTint;
          varying vec3 vCrowdColor;
          varying vec3 vCrowdSurface;`,
        )
        .replace(
          "#include <color_vertex>",
          `#include <color_vertex>
          int crowdMaterial = int(crowdShade.w + 0.5);
          vCrowdColor = crowdShade.xyz * texelFetch(crowdColors, ivec2(crowdMaterial, int(crowdPlace.w + 0.5)), 0).rgb;
          vCrowdColor = mix(vCrowdColor, crowdTint.rgb * (0.55 + 0.45 * dot(crowdShade.xyz, vec3(0.333))), crowdTint.a);
          vCrowdSurface = crowdSurfaces[crowdMaterial];`,
        );
      shader.fragmentShader = shader.fragmentShader
        .replace("#include <common>", "#include <common>\nvarying vec3 vCrowdColor;\nvarying vec3 vCrowdSurface;\nuniform float crowdGlow;")
        .replace("#include <color_fragment>", "#include <color_fragment>\ndiffuseColor.rgb = vCrowdColor;")
        .replace("#include <roughnessmap_fragment>", "float roughnessFactor = vCrowdSurface.x;")
        .replace("#include <metalnessmap_fragment>", "float metalnessFactor = vCrowdSurface.y;")
        .replace("#include <emissivemap_fragment>", "totalEmissiveRadiance = vCrowdColor * vCrowdSurface.z * crowdGlow;");
    },
    "surface",
  );
}

/** One level of detail: its mesh, and who is drawn with it. */
class LevelMesh {
  readonly mesh: THREE.Mesh<THREE.InstancedBufferGeometry, THREE.MeshStandardMaterial>;
  readonly tint = { value: new THREE.Vector4(0, 0, 0, 0) };
  readonly triangles: number;
  readonly faces: Faces | null;
  private readonly places: THREE.InstancedBufferAttribute;
  private readonly rows: THREE.InstancedBufferAttribute;
  shown = 0;

  constructor(data: CrowdLevel, number: number, arrays: Arrays, population: Population, shared: Shared) {
    const { count } = population;
    const geometry = new THREE.InstancedBufferGeometry();
    const materials = arrays.uint8(data.materials), shades = arrays.float32(data.shades);
    const shade = new Float32Array(4 * materials.length);
    for (let v = 0; v < materials.length; v++) {
      shade.set(shades.subarray(3 * v, 3 * v + 3), 4 * v);
      shade[4 * v + 3] = materials[v];
    }
    geometry.setAttribute("position", new THREE.BufferAttribute(arrays.float32(data.positions), 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(arrays.float32(data.normals), 3));
    geometry.setAttribute("crowdJoints", new THREE.BufferAttribute(arrays.uint8(data.joints), 4));
    geometry.setAttribute("crowdWeights", new THREE.BufferAttribute(arrays.float32(data.weights), 4));
    geometry.setAttribute("crowdShade", new THREE.BufferAttribute(shade, 4));
    geometry.setIndex(new THREE.BufferAttribute(arrays.uint32(data.triangles), 1));
    this.places = new THREE.InstancedBufferAttribute(new Float32Array(4 * count), 4);
    this.rows = new THREE.InstancedBufferAttribute(new Float32Array(3 * count), 3);
    this.places.setUsage(THREE.DynamicDrawUsage);
    this.rows.setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("crowdPlace", this.places);
    geometry.setAttribute("crowdRows", this.rows);
    geometry.instanceCount = 0;
    this.triangles = data.triangles.shape[0];
    this.faces = data.morphs && new Faces(geometry, data.morphs, arrays, population.morphs, population.ready.morphs);
    const color = new THREE.Color(LEVEL_COLORS[number % LEVEL_COLORS.length]);
    this.tint.value.set(color.r, color.g, color.b, 0);
    this.mesh = new THREE.Mesh(geometry, surface(shared, this.faces, this.tint));
    this.mesh.customDepthMaterial = moving(new THREE.MeshDepthMaterial(), shared, this.faces, () => {}, "depth");
    this.mesh.frustumCulled = false; // the instances are, one by one
    this.mesh.receiveShadow = true;
  }

  begin(): void {
    this.shown = 0;
  }

  add(character: number, roots: Float32Array, rows: Float32Array): void {
    const p = 4 * this.shown, r = 3 * this.shown++, o = 3 * character;
    const places = this.places.array, drawn = this.rows.array;
    places[p] = roots[o]; places[p + 1] = roots[o + 1]; places[p + 2] = roots[o + 2]; places[p + 3] = character;
    drawn[r] = rows[o]; drawn[r + 1] = rows[o + 1]; drawn[r + 2] = rows[o + 2];
  }

  end(): void {
    const { geometry } = this.mesh;
    geometry.instanceCount = this.shown;
    this.mesh.visible = this.shown > 0;
    for (const attribute of [this.places, this.rows]) {
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, attribute.itemSize * this.shown);
      attribute.needsUpdate = true;
    }
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.mesh.customDepthMaterial?.dispose();
    this.faces?.dispose();
  }
}

export class Bodies {
  readonly root = new THREE.Group();
  readonly levels: LevelMesh[];
  readonly blobs: Blobs;
  private readonly shared: Shared;
  private readonly frustum = new THREE.Frustum();
  private readonly matrix = new THREE.Matrix4();
  private readonly sphere = new THREE.Sphere();
  visible = 0;

  constructor(container: Container<CrowdReady>, readonly population: Population) {
    const { header } = container, arrays = new Arrays(container), count = header.count;
    const matrices = new THREE.DataTexture(population.joints, population.width, 2 * count, THREE.RGBAIntegerFormat, THREE.ShortType);
    matrices.internalFormat = "RGBA16I";
    matrices.needsUpdate = true;
    const rgb = arrays.uint8(header.colors), texels = new Uint8Array((4 * rgb.length) / 3).fill(255);
    for (let n = 0; n < rgb.length / 3; n++) texels.set(rgb.subarray(3 * n, 3 * n + 3), 4 * n);
    const colors = new THREE.DataTexture(texels, header.materials.length, count);
    colors.colorSpace = THREE.SRGBColorSpace;
    colors.needsUpdate = true;
    const surfaces = Array.from({ length: MOST_MATERIALS }, (_, n) => {
      const m = header.materials[n];
      return m ? new THREE.Vector3(m.roughness, m.metallic, Math.max(...m.emissive)) : new THREE.Vector3(0.8, 0, 0);
    });
    this.shared = { matrices: { value: matrices }, unit: { value: header.unit_m }, colors: { value: colors }, surfaces: { value: surfaces }, glow: { value: 1 } };
    this.levels = header.levels.map((data, n) => new LevelMesh(data, n, arrays, population, this.shared));
    this.blobs = new Blobs(count, header.height_m);
    this.root.add(this.blobs.mesh, ...this.levels.map((l) => l.mesh));
  }

  /** Colour by level, 0 to 1, and who throws a real shadow. */
  paint(byLevel: boolean, shadows: boolean): void {
    this.levels.forEach((level, n) => {
      level.tint.value.w = byLevel ? 0.86 : 0;
      level.mesh.castShadow = shadows && n < 3;
    });
    this.shared.glow.value = byLevel ? 0 : 1;
  }

  set shade(strength: number) {
    this.blobs.strength = strength;
  }

  /** Put everybody who may be seen into the lists of their levels. */
  update(camera: THREE.Camera, cullForShadows: number): void {
    const { population, frustum, sphere } = this, { roots, rows, level, ready } = population;
    if (population.fresh) {
      this.shared.matrices.value.needsUpdate = true;
      for (const mesh of this.levels) mesh.faces?.changed();
      population.fresh = false;
    }
    frustum.setFromProjectionMatrix(this.matrix.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    for (const mesh of this.levels) mesh.begin();
    this.blobs.begin();
    this.visible = 0;
    for (let n = 0; n < population.count && population.received > 0; n++) {
      const x = roots[3 * n], z = roots[3 * n + 1];
      sphere.center.set(x, 0.5 * ready.height_m, z);
      // somebody beside the picture may throw a shadow into it
      sphere.radius = 0.75 * ready.height_m + (level[n] < 2 ? cullForShadows : 0);
      if (!frustum.intersectsSphere(sphere)) continue;
      this.visible++;
      this.levels[level[n]].add(n, roots, rows);
      this.blobs.add(x, z);
    }
    for (const mesh of this.levels) mesh.end();
    this.blobs.end();
  }

  dispose(): void {
    for (const level of this.levels) level.dispose();
    this.blobs.dispose();
    this.shared.matrices.value.dispose();
    this.shared.colors.value.dispose();
  }
}

/** A soft dark spot under everybody: what grounds them where no shadow is drawn. */
class Blobs {
  readonly mesh: THREE.Mesh<THREE.InstancedBufferGeometry, THREE.ShaderMaterial>;
  private readonly centers: THREE.InstancedBufferAttribute;
  private shown = 0;

  constructor(count: number, height: number) {
    const plane = new THREE.PlaneGeometry(1, 1).rotateX(-Math.PI / 2);
    const geometry = new THREE.InstancedBufferGeometry();
    geometry.index = plane.index;
    geometry.setAttribute("position", plane.attributes.position);
    this.centers = new THREE.InstancedBufferAttribute(new Float32Array(2 * count), 2);
    this.centers.setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("center", this.centers);
    geometry.instanceCount = 0;
    const material = new THREE.ShaderMaterial({
      transparent: true,
      depthWrite: false,
      polygonOffset: true,
      polygonOffsetFactor: -2,
      uniforms: { size: { value: 0.62 * height }, strength: { value: 0.4 }, color: { value: new THREE.Color() } },
      vertexShader: /* glsl */ `
        attribute vec2 center;
        uniform float size;
        varying vec2 at;
        void main() {
          at = position.xz * 2.0;
          gl_Position = projectionMatrix * viewMatrix * vec4(position.x * size + center.x, 0.004, position.z * size + center.y, 1.0);
        }`,
      fragmentShader: /* glsl */ `
        uniform float strength;
        uniform vec3 color;
        varying vec2 at;
        void main() {
          float away = length(at);
          gl_FragColor = vec4(color, strength * pow(max(0.0, 1.0 - away), 1.7));
          #include <colorspace_fragment>
        }`,
    });
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -5;
  }

  set strength(value: number) {
    this.mesh.material.uniforms.strength.value = value;
  }

  set color(value: THREE.Color) {
    (this.mesh.material.uniforms.color.value as THREE.Color).copy(value);
  }

  begin(): void {
    this.shown = 0;
  }

  add(x: number, z: number): void {
    const at = 2 * this.shown++;
    this.centers.array[at] = x;
    this.centers.array[at + 1] = z;
  }

  end(): void {
    this.mesh.geometry.instanceCount = this.shown;
    this.centers.clearUpdateRanges();
    this.centers.addUpdateRange(0, 2 * this.shown);
    this.centers.needsUpdate = true;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
