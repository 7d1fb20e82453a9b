// Quaternions (wxyz) inside larger arrays; nothing here allocates while playing.

export type Numbers = Float32Array | Float64Array;

/** out[o..o+3] = from a[i..] to b[j..] along the great arc, the short way, exactly a at u = 0: keypose.math.quat.slerp. */
export function slerp(a: Numbers, i: number, b: Numbers, j: number, u: number, out: Float64Array, o: number): void {
  const aw = a[i], ax = a[i + 1], ay = a[i + 2], az = a[i + 3];
  let bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  if (aw * bw + ax * bx + ay * by + az * bz < 0) {
    bw = -bw; bx = -bx; by = -by; bz = -bz;
  }
  // accurate at every angle, unlike the arc cosine of the dot product (Kahan)
  const arc = 2 * Math.atan2(length4(aw - bw, ax - bx, ay - by, az - bz), length4(aw + bw, ax + bx, ay + by, az + bz));
  let p = 1 - u, q = u;
  if (arc > 1e-9) {
    const sine = Math.sin(arc);
    p = Math.sin(p * arc) / sine;
    q = Math.sin(q * arc) / sine;
  }
  out[o] = p * aw + q * bw;
  out[o + 1] = p * ax + q * bx;
  out[o + 2] = p * ay + q * by;
  out[o + 3] = p * az + q * bz;
}

const length4 = (w: number, x: number, y: number, z: number) => Math.sqrt(w * w + x * x + y * y + z * z);

export function normalize(q: Float64Array, o: number): void {
  const length = Math.hypot(q[o], q[o + 1], q[o + 2], q[o + 3]);
  if (length === 0) {
    q[o] = 1;
    return;
  }
  const s = 1 / length;
  q[o] *= s; q[o + 1] *= s; q[o + 2] *= s; q[o + 3] *= s;
}

/** out[o..o+3] = a[i..] b[j..], the rotation b followed by a; out may be one of them. */
export function multiply(a: Numbers, i: number, b: Numbers, j: number, out: Float64Array, o: number): void {
  const aw = a[i], ax = a[i + 1], ay = a[i + 2], az = a[i + 3];
  const bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  out[o] = aw * bw - ax * bx - ay * by - az * bz;
  out[o + 1] = aw * bx + ax * bw + ay * bz - az * by;
  out[o + 2] = aw * by - ax * bz + ay * bw + az * bx;
  out[o + 3] = aw * bz + ax * by - ay * bx + az * bw;
}

/** out[o..o+2] = the half-angle vector of q[i..i+3], the short way. */
export function logShort(q: Numbers, i: number, out: Float64Array, o: number): void {
  const sign = q[i] < 0 ? -1 : 1;
  const w = sign * q[i], x = sign * q[i + 1], y = sign * q[i + 2], z = sign * q[i + 3];
  const sine = Math.sqrt(x * x + y * y + z * z);
  // no rotation at all (a zero quaternion) counts as none
  const ratio = sine > 1e-150 ? Math.atan2(sine, w) / sine : w > 0 ? 1 / w : 0;
  out[o] = ratio * x;
  out[o + 1] = ratio * y;
  out[o + 2] = ratio * z;
}

/** out[o..o+3] = the unit quaternion of a half-angle vector. */
export function exp(x: number, y: number, z: number, out: Float64Array, o: number): void {
  const angle = Math.sqrt(x * x + y * y + z * z);
  const s = angle > 1e-150 ? Math.sin(angle) / angle : 1;
  out[o] = Math.cos(angle);
  out[o + 1] = s * x;
  out[o + 2] = s * y;
  out[o + 3] = s * z;
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

/** out[o..o+3] = the inverse of a[i..] times b[j..]: what has to follow a to be b. out may be one of them. */
export function conjugateMultiply(a: Numbers, i: number, b: Numbers, j: number, out: Float64Array, o: number): void {
  const aw = a[i], ax = -a[i + 1], ay = -a[i + 2], az = -a[i + 3];
  const bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  out[o] = aw * bw - ax * bx - ay * by - az * bz;
  out[o + 1] = aw * bx + ax * bw + ay * bz - az * by;
  out[o + 2] = aw * by - ax * bz + ay * bw + az * bx;
  out[o + 3] = aw * bz + ax * by - ay * bx + az * bw;
}

const half = new Float64Array(3);

/** out[o..o+3] = q[i..] with its angle, taken the short way, scaled. */
export function powerShort(q: Numbers, i: number, exponent: number, out: Float64Array, o: number): void {
  logShort(q, i, half, 0);
  exp(exponent * half[0], exponent * half[1], exponent * half[2], out, o);
}
