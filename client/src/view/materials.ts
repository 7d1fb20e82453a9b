// Surfaces: what the file says, the weight heat map, and the ghosts of the onion skin.

import * as THREE from "three";
import type { MaterialData } from "../generated/messages";

export function surface(data: MaterialData, map: THREE.Texture | null, vertexColors: boolean): THREE.Material {
  const [r, g, b, a] = data.base_color;
  const common = {
    name: data.name,
    map,
    vertexColors,
    side: data.double_sided ? THREE.DoubleSide : THREE.FrontSide,
    transparent: data.alpha_mode === "BLEND",
    opacity: data.alpha_mode === "OPAQUE" ? 1 : a,
    alphaTest: data.alpha_mode === "MASK" ? data.alpha_cutoff : 0,
    shadowSide: data.double_sided ? THREE.DoubleSide : THREE.BackSide,
  };
  const color = new THREE.Color().setRGB(r, g, b, THREE.LinearSRGBColorSpace);
  if (data.unlit) return new THREE.MeshBasicMaterial({ ...common, color });
  const [er, eg, eb] = data.emissive;
  return new THREE.MeshStandardMaterial({
    ...common,
    color,
    metalness: data.metallic,
    roughness: data.roughness,
    emissive: new THREE.Color().setRGB(er, eg, eb, THREE.LinearSRGBColorSpace),
  });
}

/** Decodes a picture that came with the scene; a damaged one leaves the surface plain. */
export async function picture(bytes: Uint8Array<ArrayBuffer>, mimeType: string): Promise<THREE.Texture | null> {
  try {
    const bitmap = await createImageBitmap(new Blob([bytes], { type: mimeType }), {
      premultiplyAlpha: "none",
      colorSpaceConversion: "none",
    });
    const texture = new THREE.Texture(bitmap);
    texture.flipY = false;
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    texture.anisotropy = 4;
    texture.needsUpdate = true;
    return texture;
  } catch {
    return null;
  }
}

/** Heat map of one joint's influence; `joint` is its place in the palette of the part, -1 where it has none. */
export class WeightMaterial extends THREE.MeshStandardMaterial {
  readonly joint = { value: -1 };

  constructor(skinned: boolean) {
    super({ roughness: 0.9, metalness: 0, side: THREE.DoubleSide });
    this.onBeforeCompile = (shader) => {
      shader.uniforms.heatJoint = this.joint;
      const weight = skinned
        ? `vec4 hit = vec4(equal(ivec4(skinIndex + 0.5), ivec4(int(heatJoint)))); heat = dot(skinWeight, hit);`
        : `heat = heatJoint >= 0.0 ? 1.0 : 0.0;`;
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nuniform float heatJoint;\nvarying float heat;")
        .replace("#include <begin_vertex>", `#include <begin_vertex>\n${weight}`);
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          `#include <common>
          varying float heat;
          vec3 heatColor(float t) {
            vec3 c = mix(vec3(0.055, 0.075, 0.13), vec3(0.03, 0.16, 0.50), smoothstep(0.0, 0.18, t));
            c = mix(c, vec3(0.02, 0.45, 0.42), smoothstep(0.15, 0.42, t));
            c = mix(c, vec3(0.85, 0.62, 0.05), smoothstep(0.40, 0.72, t));
            return mix(c, vec3(0.90, 0.10, 0.03), smoothstep(0.72, 1.0, t));
          }`,
        )
        .replace("#include <color_fragment>", "#include <color_fragment>\ndiffuseColor.rgb = heatColor(heat);");
    };
    this.customProgramCacheKey = () => `weights-${skinned}`;
  }
}

const GHOST_VERTEX = /* glsl */ `
#include <common>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
uniform float behind;
invariant gl_Position;
varying vec3 vNormalView;
varying vec3 vPositionView;
void main() {
  #include <beginnormal_vertex>
  #include <morphnormal_vertex>
  #include <skinbase_vertex>
  #include <skinnormal_vertex>
  #include <defaultnormal_vertex>
  #include <begin_vertex>
  #include <morphtarget_vertex>
  #include <skinning_vertex>
  #include <project_vertex>
  vNormalView = transformedNormal;
  vPositionView = -mvPosition.xyz;
  // as deep as if it stood a little further away: where it nearly touches the character, the character stays clean
  vec4 deeper = projectionMatrix * vec4(mvPosition.xy, mvPosition.z - behind, 1.0);
  gl_Position.z = deeper.z / deeper.w * gl_Position.w;
}`;

const GHOST_FRAGMENT = /* glsl */ `
uniform vec3 color;
uniform float strength;
varying vec3 vNormalView;
varying vec3 vPositionView;
void main() {
  float facing = abs(dot(normalize(vNormalView), normalize(vPositionView)));
  float rim = pow(1.0 - facing, 2.0);
  gl_FragColor = vec4(color, strength * (0.16 + 0.84 * rim));
  #include <colorspace_fragment>
}`;

export function ghostMaterial(color: THREE.Color, strength: number, behind: number): THREE.ShaderMaterial {
  return new THREE.ShaderMaterial({
    vertexShader: GHOST_VERTEX,
    fragmentShader: GHOST_FRAGMENT,
    uniforms: { color: { value: color }, strength: { value: strength }, behind: { value: behind } },
    transparent: true,
    depthWrite: false,
    depthFunc: THREE.LessEqualDepth,
  });
}

/** Fills only the depth buffer, so that a ghost does not show its own far side. */
export function ghostDepthMaterial(behind: number): THREE.ShaderMaterial {
  return new THREE.ShaderMaterial({
    vertexShader: GHOST_VERTEX,
    fragmentShader: "void main() { gl_FragColor = vec4(0.0); }",
    uniforms: { behind: { value: behind } },
    colorWrite: false,
    transparent: true,
  });
}
