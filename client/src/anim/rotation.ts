// Quaternions (wxyz) inside larger arrays; nothing here allocates while playing.

export type Numbers = Float32Array | Float64Array;

/** out[o..o+3] = the rotation between a[i..] and b[j..] at u, the short way. */
export function slerp(a: Numbers, i: number, b: Numbers, j: number, u: number, out: Float64Array, o: number): void {
  const aw = a[i], ax = a[i + 1], ay = a[i + 2], az = a[i + 3];
  let bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  let dot = aw * bw + ax * bx + ay * by + az * bz;
  if (dot < 0) {
    dot = -dot;
    bw = -bw; bx = -bx; by = -by; bz = -bz;
  }
  let p = 1 - u, q = u;
  if (dot < 0.9999995) {
    const angle = Math.acos(dot);
    const sine = Math.sin(angle);
    p = Math.sin(p * angle) / sine;
    q = Math.sin(q * angle) / sine;
  }
  out[o] = p * aw + q * bw;
  out[o + 1] = p * ax + q * bx;
  out[o + 2] = p * ay + q * by;
  out[o + 3] = p * az + q * bz;
  normalize(out, o);
}

export function normalize(q: Float64Array, o: number): void {
  const length = Math.hypot(q[o], q[o + 1], q[o + 2], q[o + 3]);
  if (length === 0) {
    q[o] = 1;
    return;
  }
  const s = 1 / length;
  q[o] *= s; q[o + 1] *= s; q[o + 2] *= s; q[o + 3] *= s;
}

export type EulerOrder = "XYZ" | "XZY" | "YXZ" | "YZX" | "ZXY" | "ZYX";
export const EULER_ORDERS: EulerOrder[] = ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"];

/** Intrinsic Euler angles in degrees, in the order they are applied; at gimbal lock the last angle is 0. */
export function euler(q: ArrayLike<number>, order: EulerOrder): [number, number, number] {
  const axes = [...order].map((a) => "XYZ".indexOf(a));
  const [i, j, k] = axes;
  const sign = (j - i + 3) % 3 === 1 ? 1 : -1;
  // R = Ri(a) Rj(b) Rk(c): R[i][k] = sign * sin(b)
  const m = matrix(q);
  const sine = Math.max(-1, Math.min(1, sign * m[i][k]));
  const b = Math.asin(sine);
  let a: number, c: number;
  if (Math.abs(sine) < 0.9999999) {
    a = Math.atan2(-sign * m[j][k], m[k][k]);
    c = Math.atan2(-sign * m[i][j], m[i][i]);
  } else {
    a = Math.atan2(sign * m[k][j], m[j][j]);
    c = 0;
  }
  const degrees = 180 / Math.PI;
  return [a * degrees, b * degrees, c * degrees];
}

function matrix(q: ArrayLike<number>): number[][] {
  const w = q[0], x = q[1], y = q[2], z = q[3];
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}
