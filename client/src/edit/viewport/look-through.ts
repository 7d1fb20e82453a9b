// The view from a joint: along a camera's own axis, or the way a joint faces that faced the front at rest.

import * as THREE from "three";
import type { Actor } from "../../view/actor";
import type { Viewport } from "../../view/viewport";
import { columnsOf, nearestOrthonormal, placeOf, within, along, type Basis, type Vec } from "./spaces";

const FRONT: Vec = [0, 0, 1];
const restWorlds = new WeakMap<Actor, Float64Array>();

function restWorld(actor: Actor): Float64Array {
  let world = restWorlds.get(actor);
  if (!world) {
    restWorlds.set(actor, (world = new Float64Array(12 * actor.rig.count)));
    actor.rig.solve(actor.rig.rest, world);
  }
  return world;
}

/** Put the view's camera into a joint; it goes along with it. */
export function alongJoint({ orbit }: Viewport, actor: Actor, joint: number): void {
  orbit.setParallel(false);
  const now: Basis = nearestOrthonormal(columnsOf(actor.rig.world, joint));
  // a camera of a file looks along its -Z; anything else, where the rest pose's front went
  const way: Vec = /cam(era)?(?![a-z])/i.test(actor.rig.names[joint])
    ? [-now[2][0], -now[2][1], -now[2][2]]
    : along(now, within(nearestOrthonormal(columnsOf(restWorld(actor), joint)), FRONT));
  const place = actor.toStage(new THREE.Vector3(...(placeOf(actor.rig.world, joint) as [number, number, number])));
  const direction = new THREE.Vector3(...(way as [number, number, number]));
  // far enough in front to be out of the head that it looks from
  place.addScaledVector(direction, 0.1 * actor.height * actor.scale);
  orbit.camera.position.copy(place);
  orbit.target.copy(place).addScaledVector(direction, actor.height * actor.scale);
}
