// The skeleton as something to look at: bones and joints as instanced solids, axes as lines.

import * as THREE from "three";
import type { Rig } from "../anim/rig";
import type { Palette } from "./palette";

interface Bone {
  joint: number;
  /** The child joint it points to, or -1 for an end site. */
  child: number;
  end: [number, number, number] | null;
}

function bonesOf(rig: Rig): Bone[] {
  const bones: Bone[] = [];
  for (let joint = 0; joint < rig.jointCount; joint++) {
    for (const child of rig.children[joint]) bones.push({ joint, child, end: null });
    const end = rig.ends.get(joint);
    if (end) bones.push({ joint, child: -1, end });
  }
  return bones;
}

/** An octahedral bone from the origin to (0, 1, 0), thickest near its start. */
function boneGeometry(sides: number): THREE.BufferGeometry {
  const rings: [number, number][] = [[0.0, 0.0], [0.6, 0.05], [1.0, 0.14], [0.42, 0.92], [0.0, 1.0]];
  const geometry = new THREE.LatheGeometry(rings.map(([r, y]) => new THREE.Vector2(r, y)), sides).toNonIndexed();
  geometry.computeVertexNormals();
  return geometry;
}

export type BoneStyle = "solid" | "overlay";

/** Which joints stand out, the last that fits wins: set by hand, hovered, selected, the active one. */
export interface Marks {
  readonly held: ReadonlySet<number>;
  readonly selected: ReadonlySet<number>;
  readonly hovered: number;
  readonly active: number;
}

export const NO_MARKS: Marks = { held: new Set(), selected: new Set(), hovered: -1, active: -1 };

export class Bones {
  readonly group = new THREE.Group();
  private readonly bones: Bone[];
  private readonly shafts: THREE.InstancedMesh;
  private readonly balls: THREE.InstancedMesh;
  private readonly size: number;
  /** Thickness of the thickest bone that starts at each joint. */
  private readonly reach: Float64Array;
  private shown: Marks | null = null;
  private base: THREE.Color | null = null;

  constructor(
    private readonly rig: Rig,
    style: BoneStyle,
    height: number,
    /** Joints that are no part of the skeleton: nodes of a file that move nothing. */
    private readonly idle: ReadonlySet<number> = new Set(),
  ) {
    this.bones = bonesOf(rig);
    this.size = height;
    this.reach = new Float64Array(rig.jointCount);
    const solid = style === "solid";
    const material = new THREE.MeshStandardMaterial({ roughness: solid ? 0.55 : 0.7, metalness: 0, flatShading: !solid });
    this.shafts = new THREE.InstancedMesh(boneGeometry(solid ? 10 : 4), material, Math.max(1, this.bones.length));
    this.balls = new THREE.InstancedMesh(new THREE.IcosahedronGeometry(1, solid ? 3 : 2), material.clone(), Math.max(1, rig.jointCount));
    (this.balls.material as THREE.MeshStandardMaterial).flatShading = false;
    this.shafts.count = this.bones.length;
    for (const mesh of [this.shafts, this.balls]) {
      mesh.frustumCulled = false;
      mesh.castShadow = solid;
      mesh.receiveShadow = solid;
      this.group.add(mesh);
    }
  }

  /** Colour joints and bones; the selected joint and its bones stand out. */
  paint(base: THREE.Color, palette: Palette, marks: Marks): void {
    if (marks === this.shown && base === this.base) return;
    this.shown = marks;
    this.base = base;
    const { held, selected, hovered, active } = marks;
    const color = (joint: number) =>
      joint === active ? palette.accent : joint === hovered ? palette.hover : selected.has(joint) ? palette.selected : held.has(joint) ? palette.held : base;
    this.bones.forEach((bone, n) => this.shafts.setColorAt(n, color(bone.joint)));
    for (let joint = 0; joint < this.rig.jointCount; joint++) this.balls.setColorAt(joint, color(joint));
    for (const mesh of [this.shafts, this.balls]) if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }

  write(world: Float64Array): void {
    const shafts = this.shafts.instanceMatrix.array as Float32Array;
    const thin = 0.003 * this.size, thick = 0.02 * this.size;
    const reach = this.reach.fill(0);
    for (let n = 0; n < this.bones.length; n++) {
      const bone = this.bones[n];
      const a = 12 * bone.joint;
      const hx = world[a + 9], hy = world[a + 10], hz = world[a + 11];
      let tx: number, ty: number, tz: number;
      if (bone.end) {
        const [x, y, z] = bone.end;
        tx = world[a] * x + world[a + 3] * y + world[a + 6] * z + hx;
        ty = world[a + 1] * x + world[a + 4] * y + world[a + 7] * z + hy;
        tz = world[a + 2] * x + world[a + 5] * y + world[a + 8] * z + hz;
      } else {
        const b = 12 * bone.child;
        tx = world[b + 9]; ty = world[b + 10]; tz = world[b + 11];
      }
      let dx = tx - hx, dy = ty - hy, dz = tz - hz;
      const length = Math.hypot(dx, dy, dz);
      const o = 16 * n;
      if (length < 1e-9) {
        shafts.fill(0, o, o + 16);
        shafts[o + 15] = 1;
        continue;
      }
      const width = Math.min(thick, Math.max(thin, 0.11 * length));
      if (width > reach[bone.joint]) reach[bone.joint] = width;
      dx /= length; dy /= length; dz /= length;
      // a side vector at right angles to the bone, from the world axis that is furthest from it
      let sx: number, sy: number, sz: number;
      if (Math.abs(dy) < 0.9) { sx = dz; sy = 0; sz = -dx; }
      else { sx = 0; sy = -dz; sz = dy; }
      const s = width / Math.hypot(sx, sy, sz);
      sx *= s; sy *= s; sz *= s;
      shafts[o] = sx; shafts[o + 1] = sy; shafts[o + 2] = sz;
      shafts[o + 4] = dx * length; shafts[o + 5] = dy * length; shafts[o + 6] = dz * length;
      shafts[o + 8] = sy * dz - sz * dy; shafts[o + 9] = sz * dx - sx * dz; shafts[o + 10] = sx * dy - sy * dx;
      shafts[o + 12] = hx; shafts[o + 13] = hy; shafts[o + 14] = hz; shafts[o + 15] = 1;
    }
    const balls = this.balls.instanceMatrix.array as Float32Array;
    for (let joint = 0; joint < this.rig.jointCount; joint++) {
      const parent = this.rig.parents[joint];
      // as thick as what it holds; a leaf as thin as the bone that reaches it
      const radius = this.idle.has(joint) ? 0 : Math.max(thin, 0.75 * (reach[joint] || 0.7 * (parent >= 0 ? reach[parent] : thick)));
      const o = 16 * joint, a = 12 * joint;
      balls[o] = balls[o + 5] = balls[o + 10] = radius;
      balls[o + 12] = world[a + 9]; balls[o + 13] = world[a + 10]; balls[o + 14] = world[a + 11];
      balls[o + 15] = 1;
    }
    this.shafts.instanceMatrix.needsUpdate = true;
    this.balls.instanceMatrix.needsUpdate = true;
  }

  dispose(): void {
    this.group.removeFromParent();
    for (const mesh of [this.shafts, this.balls]) {
      mesh.geometry.dispose();
      (mesh.material as THREE.Material).dispose();
      mesh.dispose();
    }
  }
}

const AXIS_COLORS = [0xe5484d, 0x46a758, 0x3e7bfa].map((hex) => new THREE.Color(hex));

/** The three axes of every joint: red X, green Y, blue Z. */
export class Axes {
  readonly lines: THREE.LineSegments;
  private readonly positions: Float32Array;

  private readonly lengths: Float64Array;

  /** Each as long as suits the joint's bone, so that fingers stay readable. */
  constructor(
    private readonly rig: Rig,
    height: number,
  ) {
    const { rest, parents } = rig;
    const reach = (joint: number) => Math.hypot(...rest.translations.subarray(3 * joint, 3 * joint + 3));
    this.lengths = Float64Array.from({ length: rig.jointCount }, (_, joint) => {
      const bones = rig.children[joint].map(reach).filter((length) => length > 1e-6);
      const bone = bones.length > 0 ? Math.min(...bones) : parents[joint] >= 0 ? reach(joint) : height;
      return Math.max(0.007 * height, Math.min(0.035 * height, 0.4 * bone));
    });
    this.positions = new Float32Array(18 * rig.jointCount);
    const colors = new Float32Array(18 * rig.jointCount);
    for (let n = 0; n < 6 * rig.jointCount; n++) AXIS_COLORS[(n >> 1) % 3].toArray(colors, 3 * n);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.positions, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(colors, 3));
    this.lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true, toneMapped: false }));
    this.lines.frustumCulled = false;
  }

  write(world: Float64Array): void {
    const out = this.positions;
    for (let joint = 0; joint < this.rig.jointCount; joint++) {
      const o = 12 * joint;
      const px = world[o + 9], py = world[o + 10], pz = world[o + 11];
      for (let axis = 0; axis < 3; axis++) {
        const a = o + 3 * axis, at = 18 * joint + 6 * axis;
        const length = Math.hypot(world[a], world[a + 1], world[a + 2]);
        const s = length > 0 ? this.lengths[joint] / length : 0;
        out[at] = px; out[at + 1] = py; out[at + 2] = pz;
        out[at + 3] = px + s * world[a]; out[at + 4] = py + s * world[a + 1]; out[at + 5] = pz + s * world[a + 2];
      }
    }
    this.lines.geometry.attributes.position.needsUpdate = true;
  }

  dispose(): void {
    this.lines.removeFromParent();
    this.lines.geometry.dispose();
    (this.lines.material as THREE.Material).dispose();
  }
}
