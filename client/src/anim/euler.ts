// Euler angles in radians, all 24 orders, exactly as keypose.math.euler: capitals turn about the axes of the moving body
// (intrinsic), small letters about the fixed axes of the parent (extrinsic).

const TAIT_BRYAN = ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"];
const PROPER = ["XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ"];
const INTRINSIC = [...TAIT_BRYAN, ...PROPER];
export const CONVENTIONS: readonly string[] = [...INTRINSIC, ...INTRINSIC.map((o) => o.toLowerCase())];
/** The order of a joint's angles where a clip names none. */
export const EULER_ORDER = "XYZ";

interface Axes {
  readonly i: number;
  readonly j: number;
  readonly k: number;
  readonly parity: number;
  readonly proper: boolean;
  readonly extrinsic: boolean;
}

const AXES = new Map<string, Axes>(
  CONVENTIONS.map((order) => {
    const extrinsic = order === order.toLowerCase();
    const [i, j, last] = [...(extrinsic ? [...order.toUpperCase()].reverse() : order)].map((letter) => "XYZ".indexOf(letter) + 1);
    const proper = i === last;
    return [order, { i, j, k: proper ? 6 - i - j : last, parity: (((j - i) % 3) + 3) % 3 === 1 ? 1 : -1, proper, extrinsic }];
  }),
);

function axesOf(order: string): Axes {
  const axes = AXES.get(order);
  if (!axes) throw new Error(`no Euler order '${order}'; there are ${CONVENTIONS.join(" ")}`);
  return axes;
}

/** out[o..o+3] = the rotation (wxyz) of three angles a[n..n+2]. */
export function quatFromEuler(a: ArrayLike<number>, n: number, order: string, out: Float64Array, o: number): void {
  const { i, j, k, parity, proper, extrinsic } = axesOf(order);
  const h1 = 0.5 * a[extrinsic ? n + 2 : n], h2 = 0.5 * a[n + 1], h3 = 0.5 * a[extrinsic ? n : n + 2];
  const c1 = Math.cos(h1), s1 = Math.sin(h1), c2 = Math.cos(h2), s2 = Math.sin(h2), c3 = Math.cos(h3), s3 = Math.sin(h3);
  if (proper) {
    const both = c1 * c3 - s1 * s3, third = s1 * c3 + c1 * s3;
    out[o] = c2 * both;
    out[o + i] = c2 * third;
    out[o + j] = s2 * (c1 * c3 + s1 * s3);
    out[o + k] = parity * s2 * (s1 * c3 - c1 * s3);
    return;
  }
  const cc = c1 * c3, ss = s1 * s3, sc = s1 * c3, cs = c1 * s3;
  out[o] = c2 * cc - parity * s2 * ss;
  out[o + i] = c2 * sc + parity * s2 * cs;
  out[o + j] = s2 * cc - parity * c2 * ss;
  out[o + k] = c2 * cs + parity * s2 * sc;
}

const LOCK = 16 * 2 ** -52;

/** out[o..o+2] = the angles of a unit quaternion q[n..n+3]; at gimbal lock the third, as written, is 0. */
export function eulerFromQuat(q: ArrayLike<number>, n: number, order: string, out: Float64Array | number[], o: number): void {
  const { i, j, k, parity, proper, extrinsic } = axesOf(order);
  const w = q[n], qi = q[n + i], qj = q[n + j], qk = parity * q[n + k];
  const px = proper ? w : w + qj, py = proper ? qi : qi + qk, mx = proper ? qj : w - qj, my = proper ? qk : qi - qk;
  const pp = px * px + py * py, mm = mx * mx + my * my;
  const noise = LOCK * LOCK * (pp + mm);
  const pLost = pp <= noise, mLost = mm <= noise;
  const p = Math.sqrt(pp), m = Math.sqrt(mm);
  const middle = proper ? 2 * Math.atan2(m, p) : Math.atan2(2 * (w * qj + qi * qk), p * m);
  let halfSum = pLost ? 0 : Math.atan2(py, px), halfDifference = mLost ? 0 : Math.atan2(my, mx);
  const keep = extrinsic ? -1 : 1;
  if (pLost) halfSum = keep * halfDifference;
  else if (mLost) halfDifference = keep * halfSum;
  const first = wrapped(halfSum + halfDifference);
  const third = wrapped((halfSum - halfDifference) * (proper ? 1 : parity));
  out[o] = extrinsic ? third : first;
  out[o + 1] = middle;
  out[o + 2] = extrinsic ? first : third;
}

function wrapped(angle: number): number {
  return angle > Math.PI ? angle - 2 * Math.PI : angle <= -Math.PI ? angle + 2 * Math.PI : angle;
}
