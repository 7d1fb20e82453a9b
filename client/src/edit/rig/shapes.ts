// Controls as lines: outlines in the control's own space, sets of segments drawn over the character.

import type { RigControl } from "../../generated/messages";

type Point = readonly [number, number, number];
export type Line = readonly Point[];

const circle = (axis: 0 | 1 | 2, count: number, radius = 1, centre: Point = [0, 0, 0]): Line =>
  Array.from({ length: count + 1 }, (_, n) => {
    const angle = (2 * Math.PI * n) / count, a = radius * Math.cos(angle), b = radius * Math.sin(angle);
    const [x, y, z] = axis === 0 ? [0, a, b] : axis === 1 ? [a, 0, b] : [a, b, 0];
    return [x + centre[0], y + centre[1], z + centre[2]];
  });

const closed = (points: readonly Point[]): Line => [...points, points[0]];

function box(): Line[] {
  const at = (y: number): Line => closed([[-1, y, -1], [1, y, -1], [1, y, 1], [-1, y, 1]]);
  const posts = ([[-1, -1], [1, -1], [1, 1], [-1, 1]] as const).map(([x, z]): Line => [[x, -1, z], [x, 1, z]]);
  return [at(-1), at(1), ...posts];
}

function diamond(): Line[] {
  const ring: Point[] = [[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1]];
  return [closed(ring), ...ring.map((p): Line => [[0, 1, 0], p, [0, -1, 0]])];
}

/** Four arrows over the ground, as one outline. */
function arrows(): Line[] {
  const arm: [number, number][] = [[0.16, 0.16], [0.16, 0.62], [0.36, 0.62], [0, 1], [-0.36, 0.62], [-0.16, 0.62]];
  const points: Point[] = [];
  for (let quarter = 0; quarter < 4; quarter++) {
    const angle = (quarter * Math.PI) / 2, c = Math.cos(angle), s = Math.sin(angle);
    for (const [x, z] of arm) points.push([c * x - s * z, 0, s * x + c * z]);
  }
  return [closed(points)];
}

/** The sole of a foot that looks along +Z. */
function foot(): Line[] {
  const half: [number, number][] = [[0, -1], [0.3, -0.93], [0.42, -0.66], [0.36, -0.2], [0.42, 0.2], [0.52, 0.55], [0.42, 0.86], [0.16, 1]];
  const right = half.map(([x, z]): Point => [x, 0, z]);
  const left = half.slice(1).reverse().map(([x, z]): Point => [-x, 0, z]);
  return [closed([...right, ...left])];
}

const SHAPES: Record<RigControl["shape"], () => Line[]> = {
  circle: () => [circle(1, 40)],
  square: () => [closed([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])],
  box,
  ball: () => [circle(0, 28), circle(1, 28), circle(2, 28)],
  diamond,
  arrows,
  pin: () => [[[0, 0, 0], [0, 0.72, 0]], circle(0, 16, 0.14, [0, 0.86, 0]), circle(2, 16, 0.14, [0, 0.86, 0])],
  foot,
};

/** The segments of a control, six numbers each: where they start and end in the control's own space. */
export function segmentsOf(control: Pick<RigControl, "shape" | "size_m" | "offset_m">): Float64Array {
  const out: number[] = [];
  const place = (p: Point) => p.map((v, n) => v * control.size_m + control.offset_m[n]);
  for (const line of SHAPES[control.shape]())
    for (let n = 0; n + 1 < line.length; n++) out.push(...place(line[n]), ...place(line[n + 1]));
  return Float64Array.from(out);
}
