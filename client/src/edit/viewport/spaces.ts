// Rotations (wxyz), and the linear part of model_from_joint: three columns of three numbers.

export type Vec = readonly [number, number, number];
export type Quat = readonly [number, number, number, number];
/** Columns x, y, z. */
export type Basis = readonly [Vec, Vec, Vec];

export const IDENTITY: Basis = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
export const NO_TURN: Quat = [1, 0, 0, 0];

export const add = (a: Vec, b: Vec): Vec => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a: Vec, b: Vec): Vec => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scaled = (a: Vec, s: number): Vec => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vec, b: Vec): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: Vec, b: Vec): Vec => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a: Vec): number => Math.hypot(a[0], a[1], a[2]);
export const unit = (a: Vec): Vec => {
  const size = length(a);
  return size > 0 ? scaled(a, 1 / size) : [0, 0, 0];
};

/** The vector whose components along the columns are given. */
export const along = (b: Basis, v: Vec): Vec => add(add(scaled(b[0], v[0]), scaled(b[1], v[1])), scaled(b[2], v[2]));
/** Components of a vector along orthonormal columns. */
export const within = (b: Basis, v: Vec): Vec => [dot(b[0], v), dot(b[1], v), dot(b[2], v)];
export const determinant = (b: Basis): number => dot(b[0], cross(b[1], b[2]));

/** M^-1 v; null where the columns span no space. */
export function solve(b: Basis, v: Vec): Vec | null {
  const det = determinant(b);
  if (Math.abs(det) < 1e-30) return null;
  return [dot(v, cross(b[1], b[2])) / det, dot(v, cross(b[2], b[0])) / det, dot(v, cross(b[0], b[1])) / det];
}

/**
 * The orthonormal basis nearest to another: the rotation (or reflection) in it, without its scale and shear.
 * Source: Higham, Computing the polar decomposition (1986), eq. 3.1: Newton's method on X -> (X + X^-T) / 2.
 */
export function nearestOrthonormal(b: Basis): Basis {
  let x = b;
  for (let n = 0; n < 60; n++) {
    const det = determinant(x);
    if (Math.abs(det) < 1e-30) return IDENTITY;
    const inverse: Basis = [scaled(cross(x[1], x[2]), 1 / det), scaled(cross(x[2], x[0]), 1 / det), scaled(cross(x[0], x[1]), 1 / det)];
    // scaled on the way, which makes it fast where the scale is far from 1
    const size = (m: Basis) => Math.sqrt(dot(m[0], m[0]) + dot(m[1], m[1]) + dot(m[2], m[2]));
    const gamma = Math.sqrt(size(inverse) / size(x));
    const next = x.map((column, i) => add(scaled(column, 0.5 * gamma), scaled(inverse[i], 0.5 / gamma))) as unknown as Basis;
    const moved = Math.max(...next.map((column, i) => length(subtract(column, x[i]))));
    x = next;
    if (moved < 1e-15) break;
  }
  return x;
}

export function columnsOf(world: Float64Array, joint: number): Basis {
  const o = 12 * joint;
  return [
    [world[o], world[o + 1], world[o + 2]],
    [world[o + 3], world[o + 4], world[o + 5]],
    [world[o + 6], world[o + 7], world[o + 8]],
  ];
}

export function placeOf(world: Float64Array, joint: number): Vec {
  const o = 12 * joint + 9;
  return [world[o], world[o + 1], world[o + 2]];
}

// ---- rotations -------------------------------------------------------------------------------------------------------

export const product = (a: Quat, b: Quat): Quat => [
  a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
  a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
  a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
  a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
];
export const inverse = (q: Quat): Quat => [q[0], -q[1], -q[2], -q[3]];
export const normal = (q: Quat): Quat => {
  const s = 1 / (Math.hypot(q[0], q[1], q[2], q[3]) || 1);
  return [q[0] * s, q[1] * s, q[2] * s, q[3] * s];
};
/** A turn by radians about a unit axis. */
export const turn = (axis: Vec, angle: number): Quat => {
  const s = Math.sin(0.5 * angle);
  return [Math.cos(0.5 * angle), s * axis[0], s * axis[1], s * axis[2]];
};
export const rotated = (q: Quat, v: Vec): Vec => {
  const u: Vec = [q[1], q[2], q[3]];
  const t = scaled(cross(u, v), 2);
  return add(add(v, scaled(t, q[0])), cross(u, t));
};
export const between = (a: Quat, b: Quat, u: number): Quat => {
  let d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  const s = d < 0 ? -1 : 1;
  d = Math.min(1, d * s);
  let p = 1 - u, q = u;
  if (d < 0.9999995) {
    const angle = Math.acos(d), sine = Math.sin(angle);
    p = Math.sin(p * angle) / sine;
    q = Math.sin(q * angle) / sine;
  }
  return normal([p * a[0] + s * q * b[0], p * a[1] + s * q * b[1], p * a[2] + s * q * b[2], p * a[3] + s * q * b[3]]);
};
/** The angle between two rotations, 0 to pi. */
export const angleBetween = (a: Quat, b: Quat): number => {
  const d = product(inverse(a), b);
  return 2 * Math.atan2(Math.hypot(d[1], d[2], d[3]), Math.abs(d[0]));
};
/** Axis times angle. */
export const logarithm = (q: Quat): Vec => {
  const w = q[0] < 0 ? -1 : 1, v: Vec = [w * q[1], w * q[2], w * q[3]], s = length(v);
  return s < 1e-12 ? scaled(v, 2) : scaled(v, (2 * Math.atan2(s, w * q[0])) / s);
};
