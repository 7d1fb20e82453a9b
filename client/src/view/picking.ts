// Which joint a ray meets: the surface as it is shown, and whose weights are largest there.

import * as THREE from "three";
import { deformedVertices, type PartSource } from "./parts";

interface Hit {
  distance: number;
  source: PartSource;
  corners: [number, number, number];
  point: THREE.Vector3;
  triangle: THREE.Triangle;
}

export function pickJoint(
  sources: PartSource[],
  world: Float64Array,
  morphs: Float64Array,
  ray: THREE.Ray,
): { joint: number; distance: number } | null {
  const triangle = new THREE.Triangle(), at = new THREE.Vector3();
  let best: Hit | null = null;
  for (const source of sources) {
    const vertices = deformedVertices(source, world, morphs), index = source.geometry.index!.array;
    const oneSided = !source.data.material.double_sided;
    for (let n = 0; n < index.length; n += 3) {
      triangle.a.fromArray(vertices, 3 * index[n]);
      triangle.b.fromArray(vertices, 3 * index[n + 1]);
      triangle.c.fromArray(vertices, 3 * index[n + 2]);
      if (!ray.intersectTriangle(triangle.a, triangle.b, triangle.c, oneSided, at)) continue;
      const distance = at.distanceTo(ray.origin);
      if (best && distance >= best.distance) continue;
      best = { distance, source, corners: [index[n], index[n + 1], index[n + 2]], point: at.clone(), triangle: triangle.clone() };
    }
  }
  return best && { joint: heaviest(best), distance: best.distance };
}

/** The joint with the largest share in the three corners, each as near as it is. */
function heaviest({ source, corners, point, triangle }: Hit): number {
  if (!source.skin) return source.data.joint ?? 0;
  const near = triangle.getBarycoord(point, new THREE.Vector3())?.toArray() ?? [1 / 3, 1 / 3, 1 / 3];
  const joints = source.geometry.attributes.skinIndex.array, weights = source.geometry.attributes.skinWeight.array;
  const shares = new Map<number, number>();
  corners.forEach((vertex, corner) => {
    for (let k = 4 * vertex; k < 4 * vertex + 4; k++) {
      const joint = source.skin!.palette[joints[k]];
      shares.set(joint, (shares.get(joint) ?? 0) + near[corner] * weights[k]);
    }
  });
  return [...shares].reduce((a, b) => (b[1] > a[1] ? b : a))[0];
}
