// Pictures of poses: the character itself, in that pose, in the colours of the theme.

import * as THREE from "three";
import type { Actor } from "../../view/actor";
import type { Viewport } from "../../view/viewport";
import type { StoredPose } from "../contract";

const SIZE = 192;
const cache = new WeakMap<StoredPose, Map<string, string>>();

/** A picture of a pose as a data URL. The window is not redrawn in between, so nothing flickers. */
export function thumbnail(view: Viewport, actor: Actor, pose: StoredPose): string {
  const key = `${actor.id} ${view.theme}`;
  const known = cache.get(pose) ?? new Map<string, string>();
  cache.set(pose, known);
  let url = known.get(key);
  if (!url) known.set(key, (url = drawPose(view, actor, pose)));
  return url;
}

function drawPose(view: Viewport, actor: Actor, stored: StoredPose): string {
  const { rig } = actor, { pose } = rig;
  const kept = { translations: pose.translations.slice(), rotations: pose.rotations.slice(), scales: pose.scales.slice(), morphs: pose.morphs.slice() };
  const shown = view.actors.map((a) => a.visible);
  const { display } = view;
  try {
    pose.copy(rig.rest);
    const whole = Object.keys(stored.joints).length >= 0.6 * rig.count;
    for (const [name, local] of Object.entries(stored.joints)) {
      const joint = rig.index(name);
      if (joint < 0) continue;
      pose.translations.set(local.translation, 3 * joint);
      pose.rotations.set(local.rotation, 4 * joint);
      pose.scales.set(local.scale, 3 * joint);
    }
    for (const [name, weight] of Object.entries(stored.morphs)) {
      const m = actor.morphNames.indexOf(name);
      if (m >= 0) pose.morphs[m] = weight;
    }
    view.actors.forEach((a) => a.setVisible(a === actor));
    view.display = { ...display, bones: false, axes: false, weights: false, ghosts: false, grid: false };
    view.applyDisplay();
    actor.showPose();
    const box = boxOf(actor, whole ? null : stored);
    return view.picture(SIZE, SIZE, (canvas) => canvas.toDataURL("image/webp", 0.85), { camera: aimed(box), bare: true });
  } finally {
    for (const name of ["translations", "rotations", "scales", "morphs"] as const) pose[name].set(kept[name]);
    view.actors.forEach((a, n) => a.setVisible(shown[n]));
    view.display = display;
    view.applyDisplay();
    view.pose();
  }
}

/** What is to be seen: the whole character, or the joints of the pose and those around them. */
function boxOf(actor: Actor, stored: StoredPose | null): THREE.Box3 {
  const box = new THREE.Box3(), point = new THREE.Vector3();
  const { rig } = actor;
  if (!stored) {
    for (let joint = 0; joint < rig.count; joint++) box.expandByPoint(actor.toStage(actor.jointPosition(joint, point)));
    // hands, feet and what is on the head reach beyond their joints
    const tall = actor.height * actor.scale;
    box.expandByScalar(0.06 * tall);
    box.max.y += 0.11 * tall;
    return box;
  }
  for (const name of Object.keys(stored.joints)) {
    const joint = rig.index(name);
    if (joint < 0) continue;
    for (const j of [joint, ...rig.children[joint]]) box.expandByPoint(actor.toStage(actor.jointPosition(j, point)));
  }
  return box.expandByScalar(0.06 * actor.height * actor.scale);
}

const FOV_DEG = 26;

/** A camera a little from the side, for a square picture. */
function aimed(box: THREE.Box3): THREE.PerspectiveCamera {
  const centre = box.getCenter(new THREE.Vector3()), size = box.getSize(new THREE.Vector3());
  const radius = 0.5 * Math.max(size.y, Math.hypot(size.x, 0.4 * size.z));
  const distance = radius / Math.tan((FOV_DEG * Math.PI) / 360) + 0.5 * size.z;
  const camera = new THREE.PerspectiveCamera(FOV_DEG, 1, 0.02 * distance, 40 * distance);
  camera.position.copy(centre).add(new THREE.Vector3(0.34, 0.1, 1).normalize().multiplyScalar(distance));
  camera.lookAt(centre);
  camera.updateMatrixWorld();
  return camera;
}
