// A character on the stage: its rig, its bodies, what it performs, and what is drawn over it.

import * as THREE from "three";
import type { CharacterData } from "../generated/messages";
import type { Animation, Binding } from "../anim/animation";
import { Pose, Rig } from "../anim/rig";
import type { Arrays } from "../net/container";
import { Axes, Bones, type Marks } from "./bones";
import { Ghosts, type GhostSettings } from "./ghosts";
import { WeightMaterial } from "./materials";
import { Body, deformedVertices, partSources, type PartMesh, type PartSource } from "./parts";
import { pickJoint } from "./picking";
import type { Palette } from "./palette";

export type Surface = "shaded" | "wire" | "none";

export class Actor {
  readonly id: string;
  readonly name: string;
  readonly rig: Rig;
  readonly morphNames: string[];
  readonly sources: PartSource[];
  readonly root = new THREE.Group();
  readonly overlay = new THREE.Group();
  readonly hasMesh: boolean;
  readonly vertices: number;
  readonly triangles: number;
  readonly rootJoint: number;
  /** Bounds of the first pose, in the character's own space. */
  readonly bounds = new THREE.Box3();
  /** Where the root joint was when the bounds were measured. */
  readonly measuredRoot = new THREE.Vector3();
  readonly height: number;
  /** Morph weights set by hand; NaN where the animation or the rest decides. */
  readonly morphOverrides: Float64Array;
  animation: Animation | null = null;
  visible = true;
  /** How much larger it is shown than it is; 1 unless giants and mice stand side by side. */
  scale = 1;

  private binding: Binding | null = null;
  private readonly body: Body;
  private readonly solid: Bones | null;
  private bones: Bones | null = null;
  private axes: Axes | null = null;
  private weights: WeightMaterial[] | null = null;
  private ghosts: Ghosts | null = null;

  constructor(
    data: CharacterData,
    arrays: Arrays,
    textures: (THREE.Texture | null)[],
    readonly sceneId: string,
    index: number,
    fallbackName: string,
  ) {
    this.id = `${sceneId}#${index}`;
    this.name = data.name || fallbackName;
    this.morphNames = data.morph_names;
    this.rig = new Rig(data.skeleton, arrays, arrays.float32(data.rest_morph_weights), data.attributes);
    this.morphOverrides = new Float64Array(this.morphNames.length).fill(NaN);
    this.sources = partSources(data.parts, arrays, textures);
    this.hasMesh = this.sources.length > 0;
    this.vertices = this.sources.reduce((n, s) => n + s.geometry.attributes.position.count, 0);
    this.triangles = this.sources.reduce((n, s) => n + s.geometry.index!.count / 3, 0);
    this.rootJoint = data.roles.hips ?? this.findRoot();
    this.body = new Body(this.sources, this.morphNames.length, (source) => [source.material]);
    for (const mesh of this.body.meshes) mesh.castShadow = mesh.receiveShadow = true;
    this.root.add(this.body.group);
    this.measure();
    this.height = Math.max(1e-3, this.bounds.getSize(new THREE.Vector3()).length() / 1.35);
    this.solid = this.hasMesh ? null : new Bones(this.rig, "solid", this.height);
    if (this.solid) this.root.add(this.solid.group);
    this.refresh();
  }

  /** The first joint with more than one child, or the first root: what moves through the world. */
  private findRoot(): number {
    let joint = 0;
    while (this.rig.children[joint]?.length === 1 && joint < this.rig.count - 1) {
      const child = this.rig.children[joint][0];
      if (this.rig.children[child].length === 0) break;
      joint = child;
      if (this.rig.children[joint].length > 1) break;
    }
    return this.rig.children[joint]?.length > 1 ? joint : 0;
  }

  private measure(): void {
    this.bounds.makeEmpty();
    this.jointPosition(this.rootJoint, this.measuredRoot);
    const point = new THREE.Vector3();
    for (const source of this.sources) {
      const positions = deformedVertices(source, this.rig.world, this.rig.pose.morphs);
      for (let i = 0; i < positions.length; i += 3) {
        point.set(positions[i], positions[i + 1], positions[i + 2]);
        if (Number.isFinite(point.x + point.y + point.z)) this.bounds.expandByPoint(point);
      }
    }
    if (this.bounds.isEmpty()) for (let joint = 0; joint < this.rig.jointCount; joint++) this.bounds.expandByPoint(this.jointPosition(joint, point));
    if (this.bounds.isEmpty()) this.bounds.set(new THREE.Vector3(-0.5, 0, -0.5), new THREE.Vector3(0.5, 1, 0.5));
  }

  /** Measure again at the start of the animation, with room for where its joints reach around the root. */
  measurePerformance(): void {
    const { animation } = this;
    this.evaluate(animation?.start ?? 0);
    this.measure();
    if (!animation) return;
    const pose = this.rig.newPose(), world = new Float64Array(12 * this.rig.count);
    const root = new THREE.Vector3(), point = new THREE.Vector3();
    for (let n = 1; n <= 24; n++) {
      this.evaluate(animation.start + (n / 24) * animation.duration, pose, world);
      this.jointPosition(this.rootJoint, root, world).sub(this.measuredRoot).setY(0);
      for (const joint of this.visibleJoints()) {
        this.jointPosition(joint, point, world).sub(root);
        if (Number.isFinite(point.x + point.y + point.z)) this.bounds.expandByPoint(point);
      }
    }
  }

  /** The joints that hold something to see; cameras and lamps of a file are joints too. */
  private visibleJoints(): Iterable<number> {
    if (!this.hasMesh) return Array(this.rig.jointCount).keys();
    return new Set(this.sources.flatMap(({ skin, data }) => (skin ? [...skin.palette] : [data.joint ?? 0])));
  }

  /** Joints alone beside the skeleton that nothing is skinned to: the nodes of skinned meshes, in many files. */
  private idleJoints(): ReadonlySet<number> {
    const { parents, children, jointCount } = this.rig, used = new Set(this.visibleJoints());
    const alone = (joint: number) => parents[joint] < 0 && children[joint].length === 0 && !used.has(joint);
    return new Set(jointCount > 1 ? [...Array(jointCount).keys()].filter(alone) : []);
  }

  /** A point of the character's own space as it stands on the stage. */
  toStage(point: THREE.Vector3): THREE.Vector3 {
    return point.multiplyScalar(this.scale).add(this.root.position);
  }

  /** A joint in the character's own space. */
  jointPosition(joint: number, out: THREE.Vector3, world: Float64Array = this.rig.world): THREE.Vector3 {
    const o = 12 * joint;
    return out.set(world[o + 9], world[o + 10], world[o + 11]);
  }

  setAnimation(animation: Animation | null): void {
    this.animation = animation;
    this.binding = animation?.bind(this.rig, this.morphNames) ?? null;
  }

  /** Solve the pose of a time; a time outside the animation wraps, so that short clips repeat beside long ones. */
  evaluate(time: number, pose: Pose = this.rig.pose, world: Float64Array = this.rig.world): void {
    if (this.binding) this.binding.apply(time, pose);
    else pose.copy(this.rig.rest);
    const overrides = this.morphOverrides;
    for (let m = 0; m < overrides.length; m++) if (overrides[m] === overrides[m]) pose.morphs[m] = overrides[m];
    this.rig.solve(pose, world);
  }

  /** How far the root wanders over the current animation, in metres. */
  travel(): number {
    const { animation } = this;
    if (!animation) return 0;
    const box = new THREE.Box2(), point = new THREE.Vector3(), flat = new THREE.Vector2();
    const pose = this.rig.newPose(), world = new Float64Array(12 * this.rig.count);
    for (let n = 0; n <= 16; n++) {
      this.evaluate(animation.start + (n / 16) * animation.duration, pose, world);
      this.jointPosition(this.rootJoint, point, world);
      box.expandByPoint(flat.set(point.x, point.z));
    }
    return box.getSize(flat).length();
  }

  /** Whether the current animation moves a morph channel. */
  animatesMorph(channel: number): boolean {
    return this.binding?.morphs.has(channel) ?? false;
  }

  /** Evaluate and hand everything to the graphics card. */
  update(time: number): void {
    this.evaluate(time);
    this.refresh();
    this.ghosts?.update(this, time);
  }

  /** Show the pose that lies in the rig, whoever has written it. */
  showPose(): void {
    this.rig.solve();
    this.refresh();
  }

  private refresh(): void {
    const { world, pose } = this.rig;
    this.body.write(world, pose.morphs);
    this.solid?.write(world);
    this.bones?.write(world);
    this.axes?.write(world);
  }

  place(x: number, z: number, scale: number): void {
    this.scale = scale;
    for (const group of [this.root, this.overlay]) {
      group.position.set(x, 0, z);
      group.scale.setScalar(scale);
    }
  }

  setVisible(visible: boolean): void {
    this.visible = visible;
    this.root.visible = this.overlay.visible = visible;
  }

  // ---- what is drawn over it ----------------------------------------------------------------------------------------

  showBones(shown: boolean): void {
    if (shown && !this.bones && this.hasMesh) {
      this.bones = new Bones(this.rig, "overlay", this.height, this.idleJoints());
      this.overlay.add(this.bones.group);
      this.bones.write(this.rig.world);
    } else if (!shown && this.bones) {
      this.bones.dispose();
      this.bones = null;
    }
  }

  showAxes(shown: boolean): void {
    if (shown && !this.axes) {
      this.axes = new Axes(this.rig, this.height);
      this.overlay.add(this.axes.lines);
      this.axes.write(this.rig.world);
    } else if (!shown && this.axes) {
      this.axes.dispose();
      this.axes = null;
    }
  }

  /** The heat map of a joint's weights, or the character's own surfaces. */
  showWeights(joint: number | null): void {
    if (joint === null) {
      if (!this.weights) return;
      this.body.meshes.forEach((mesh) => (mesh.material = (mesh.userData.source as PartSource).material));
      this.weights.forEach((material) => material.dispose());
      this.weights = null;
      return;
    }
    this.weights ??= this.body.meshes.map((mesh) => {
      const source = mesh.userData.source as PartSource;
      const material = this.body.taught(source, new WeightMaterial(source.skin !== null));
      mesh.material = material;
      return material;
    });
    this.body.meshes.forEach((mesh: PartMesh, n) => {
      const { skin, data } = mesh.userData.source as PartSource;
      this.weights![n].joint.value = skin ? skin.palette.indexOf(joint) : data.joint === joint ? 0 : -1;
    });
  }

  showGhosts(settings: GhostSettings | null, palette: Palette): void {
    this.ghosts?.dispose();
    this.ghosts = settings && this.animation ? new Ghosts(this, settings, palette) : null;
    if (this.ghosts) this.root.add(this.ghosts.group);
  }

  /** When the visible ghosts stand. */
  ghostTimes(): number[] {
    return this.ghosts?.times() ?? [];
  }

  paint(palette: Palette, marks: Marks): void {
    this.solid?.paint(palette.bone, palette, marks);
    this.bones?.paint(palette.overlayBone, palette, marks);
  }

  /** Surfaces, their edges alone, or none (the skeleton stays). */
  showSurface(surface: Surface): void {
    this.body.group.visible = surface !== "none";
    for (const { material } of this.sources)
      if ("wireframe" in material) (material as THREE.MeshStandardMaterial).wireframe = surface === "wire";
  }

  /** The joint under a ray of the character's own space: the one that moves most of the surface where the ray meets it. */
  pickSurface(ray: THREE.Ray): { joint: number; distance: number } | null {
    if (!this.body.group.visible) return null;
    return pickJoint(this.sources, this.rig.world, this.rig.pose.morphs, ray);
  }

  dispose(): void {
    this.ghosts?.dispose();
    this.bones?.dispose();
    this.axes?.dispose();
    this.solid?.dispose();
    this.weights?.forEach((material) => material.dispose());
    this.body.dispose();
    for (const source of this.sources) {
      source.geometry.dispose();
      source.material.dispose();
      source.morphs?.dispose();
    }
    this.root.removeFromParent();
    this.overlay.removeFromParent();
  }
}
