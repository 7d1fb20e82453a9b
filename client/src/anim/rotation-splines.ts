// Smooth rotation curves through unit quaternions (wxyz), as keypose.math.rotation_splines computes them.
//
// Every span is written in the frame of its first key by three half-angle vectors, nine numbers of `controls`: what leads to
// the outer control of the first key, what leads to the next key, and what leads from the next key to its own control.
// Controls are computed once for a curve; evaluation allocates nothing.

export type RotationMethod = "squad" | "spherical-bezier" | "log-cubic";
type Doubles = Float32Array | Float64Array;

/** Controls (9 numbers for each of the K - 1 spans) of a curve through K keys (4 numbers each). */
export function rotationControls(method: RotationMethod, values: Doubles, times: Float64Array): Float64Array {
  const spans = times.length - 1;
  const controls = new Float64Array(Math.max(0, spans) * 9);
  if (spans < 1) return controls;
  const chords = new Float64Array(spans * 3);
  for (let s = 0; s < spans; s++) logBetween(values, 4 * s, 4 * s + 4, chords, 3 * s);
  for (let s = 0; s < spans; s++) for (let c = 0; c < 3; c++) controls[9 * s + 3 + c] = chords[3 * s + c];
  if (method === "log-cubic") {
    logCubicControls(chords, times, controls);
    return controls;
  }
  const bezier = method === "spherical-bezier";
  const rates = keyRates(chords, times, bezier ? bisectedRate : parabolaRate);
  for (let s = 0; s < spans; s++) {
    const span = times[s + 1] - times[s];
    for (let c = 0; c < 3; c++) {
      const out = span * rates[3 * s + c], back = span * rates[3 * s + 3 + c], chord = chords[3 * s + c];
      controls[9 * s + c] = bezier ? out / 3 : (out - chord) / 2;
      controls[9 * s + 6 + c] = bezier ? -back / 3 : (chord - back) / 2;
    }
  }
  return controls;
}

/** out[o..o+3] = the curve in the span that starts with a key, at u in 0..1; at u = 0 it is the key, bit for bit. */
export function rotationSpline(
  method: RotationMethod, values: Doubles, controls: Float64Array, span: number, u: number, out: Float64Array, o: number,
): void {
  const key = 4 * span, at = 9 * span;
  if (u === 0) {
    for (let c = 0; c < 4; c++) out[o + c] = values[key + c];
    return;
  }
  if (method === "log-cubic") {
    const v = 1 - u, a = 3 * u * v * v, b = 3 * u * u * v, d = u * u * u;
    for (let c = 0; c < 3; c++) {
      const chord = controls[at + 3 + c];
      vector[c] = a * controls[at + c] + b * (chord + controls[at + 6 + c]) + d * chord;
    }
    exp(vector, 0, 1, Q);
  } else {
    exp(controls, at, 1, OUT);
    exp(controls, at + 3, 1, TO);
    exp(controls, at + 6, 1, R);
    multiply(TO, 0, R, 0, BACK, 0);
    if (method === "squad") {
      exp(controls, at + 3, u, Q);
      arc(OUT, BACK, u, R);
      arc(Q, R, 2 * u * (1 - u), Q);
    } else {
      exp(controls, at, u, Q);
      arc(OUT, BACK, u, R);
      arc(BACK, TO, u, BACK);
      arc(Q, R, u, Q);
      arc(R, BACK, u, R);
      arc(Q, R, u, Q);
    }
  }
  multiply(values, key, Q, 0, out, o);
}

/** Angular velocities in rad/s, in the frame of each key, with which spans start and end: 6 numbers for each span. */
export function endVelocities(method: RotationMethod, controls: Float64Array, times: Float64Array): Float64Array {
  const spans = Math.max(0, times.length - 1);
  const found = new Float64Array(6 * spans);
  for (let s = 0; s < spans; s++) {
    const per = 2 / (times[s + 1] - times[s]);
    for (let c = 0; c < 3; c++) {
      const out = controls[9 * s + c], chord = controls[9 * s + 3 + c], back = controls[9 * s + 6 + c];
      found[6 * s + c] = method === "squad" ? per * (chord + 2 * out) : 3 * per * out;
      found[6 * s + 3 + c] = method === "squad" ? per * (chord - 2 * back) : -3 * per * back;
    }
    if (method === "log-cubic") {
      const full = [0, 1, 2].map((c) => 2 * controls[9 * s + 3 + c]) as Vector;
      const end = apply(jacobian(full), [found[6 * s + 3], found[6 * s + 4], found[6 * s + 5]]);
      found.set(end, 6 * s + 3);
    }
  }
  return found;
}

// --- quaternions in arrays --------------------------------------------------------------------------------------------

const vector = new Float64Array(3);
const [Q, R, OUT, TO, BACK, PRODUCT] = Array.from({ length: 6 }, () => new Float64Array(4));

/** exp of a half-angle vector, scaled. */
function exp(v: Doubles | readonly number[], i: number, scale: number, out: Float64Array): void {
  const x = scale * v[i], y = scale * v[i + 1], z = scale * v[i + 2];
  const length = Math.hypot(x, y, z);
  const s = sinc(length);
  out[0] = Math.cos(length);
  out[1] = s * x;
  out[2] = s * y;
  out[3] = s * z;
}

/** The half-angle vector of a quaternion; of -1, where every axis would do, half a turn about X. */
function log(q: Float64Array, out: Doubles, o: number): void {
  const length = Math.hypot(q[1], q[2], q[3]);
  if (length < 1e-150) {
    out[o] = q[0] < 0 ? Math.PI : 0;
    out[o + 1] = out[o + 2] = 0;
    return;
  }
  const s = Math.atan2(length, q[0]) / length;
  out[o] = s * q[1];
  out[o + 1] = s * q[2];
  out[o + 2] = s * q[3];
}

function multiply(a: Doubles, i: number, b: Doubles, j: number, out: Float64Array, o: number): void {
  const aw = a[i], ax = a[i + 1], ay = a[i + 2], az = a[i + 3];
  const bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  out[o] = aw * bw - ax * bx - ay * by - az * bz;
  out[o + 1] = aw * bx + ax * bw + ay * bz - az * by;
  out[o + 2] = aw * by + ay * bw + az * bx - ax * bz;
  out[o + 3] = aw * bz + az * bw + ax * by - ay * bx;
}

/** out = conjugate(a) b */
function between(a: Doubles, i: number, b: Doubles, j: number, out: Float64Array): void {
  const aw = a[i], ax = -a[i + 1], ay = -a[i + 2], az = -a[i + 3];
  const bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  out[0] = aw * bw - ax * bx - ay * by - az * bz;
  out[1] = aw * bx + ax * bw + ay * bz - az * by;
  out[2] = aw * by + ay * bw + az * bx - ax * bz;
  out[3] = aw * bz + az * bw + ax * by - ay * bx;
}

function logBetween(values: Doubles, i: number, j: number, out: Float64Array, o: number): void {
  between(values, i, values, j, PRODUCT);
  if (PRODUCT[0] < 0) for (let c = 0; c < 4; c++) PRODUCT[c] = -PRODUCT[c];
  log(PRODUCT, out, o);
}

/** From a to b as they are given, be it the long way: what must not jump cannot choose. */
function arc(a: Float64Array, b: Float64Array, u: number, out: Float64Array): void {
  between(a, 0, b, 0, PRODUCT);
  log(PRODUCT, vector, 0);
  exp(vector, 0, u, PRODUCT);
  multiply(a, 0, PRODUCT, 0, out, 0);
}

// --- velocities at keys ------------------------------------------------------------------------------------------------

type Rate = (a: Float64Array, b: Float64Array, before: number, after: number, out: Float64Array) => void;

/** Of the parabola through a key and its neighbours, in the key's tangent space. */
const parabolaRate: Rate = (a, b, before, after, out) => {
  const share = after / (before + after);
  for (let c = 0; c < 3; c++) out[c] = share * a[c] + (1 - share) * b[c];
};

/** Shoemake: the previous key doubled over the key, bisected with the next one. */
const bisectedRate: Rate = (a, b, before, after, out) => {
  const step = Math.min(before, after);
  exp(a, 0, step, Q);
  exp(b, 0, step, R);
  arc(Q, R, 1 - after / (before + after), Q);
  log(Q, out, 0);
  for (let c = 0; c < 3; c++) out[c] /= step;
};

function keyRates(chords: Float64Array, times: Float64Array, rate: Rate): Float64Array {
  const keys = times.length, rates = new Float64Array(3 * keys);
  const a = new Float64Array(3), b = new Float64Array(3), found = new Float64Array(3);
  for (let k = 0; k < keys; k++) {
    const before = k > 0 ? times[k] - times[k - 1] : 0, after = k < keys - 1 ? times[k + 1] - times[k] : 0;
    for (let c = 0; c < 3; c++) {
      a[c] = k > 0 ? chords[3 * k - 3 + c] / before : 0;
      b[c] = k < keys - 1 ? chords[3 * k + c] / after : 0;
    }
    if (k === 0) found.set(b);
    else if (k === keys - 1) found.set(a);
    else {
      rate(a, b, before, after, found);
      // beside a much shorter span a long one could be asked to turn round and round, which no control can say
      const turned = Math.max(before, after) * Math.hypot(found[0], found[1], found[2]);
      if (turned > Math.PI) for (let c = 0; c < 3; c++) found[c] *= Math.PI / turned;
    }
    rates.set(found, 3 * k);
  }
  return rates;
}

// --- the cubic in log space ----------------------------------------------------------------------------------------------

type Vector = [number, number, number];
type Matrix = Float64Array; // 3 rows of 3

const NEWTON_STEPS = 7;

function logCubicControls(halfChords: Float64Array, times: Float64Array, controls: Float64Array): void {
  const spans = times.length - 1;
  const h = Array.from({ length: spans }, (_, s) => times[s + 1] - times[s]);
  const chords = h.map((_, s) => [0, 1, 2].map((c) => 2 * halfChords[3 * s + c]) as Vector);
  const velocities = h.map((_, s) => scale(chords[s], 1 / h[s]));
  velocities.unshift(velocities[0].slice() as Vector);
  if (spans > 1) oneAcceleration(chords, h, velocities);
  for (let s = 0; s < spans; s++) {
    const slope = apply(inverseJacobian(chords[s]), velocities[s + 1]);
    for (let c = 0; c < 3; c++) {
      controls[9 * s + c] = (h[s] / 6) * velocities[s][c];
      controls[9 * s + 6 + c] = (-h[s] / 6) * slope[c];
    }
  }
}

/** Angular velocities at the inner keys with which the accelerations of both sides agree, by Newton's method. */
function oneAcceleration(chords: Vector[], h: number[], velocities: Vector[]): void {
  const inner = velocities.length - 2;
  const lower: Matrix[] = [], upper: Matrix[] = [], back: Matrix[] = [], diagonal: number[] = [], pull: Vector[] = [];
  for (let i = 0; i < inner; i++) {
    lower.push(scaled(jacobian(chords[i]), 2 / h[i]));
    upper.push(scaled(inverseJacobian(chords[i + 1]), 2 / h[i + 1]));
    back.push(inverseJacobian(chords[i]));
    diagonal.push(4 / h[i] + 4 / h[i + 1]);
    pull.push(add(scale(chords[i], 6 / (h[i] * h[i])), scale(chords[i + 1], 6 / (h[i + 1] * h[i + 1]))));
  }
  const gap = (w: Vector[], curved: boolean) => {
    const found: Vector[] = [], blocks: Matrix[] = [];
    let error = 0;
    for (let i = 0; i < inner; i++) {
      const turn = turning(chords[i], apply(back[i], w[i + 1]));
      const left = apply(lower[i], w[i]), right = apply(upper[i], w[i + 2]);
      const g = [0, 1, 2].map(
        (c) => pull[i][c] - (curved ? turn.value[c] : 0) - left[c] - diagonal[i] * w[i + 1][c] - right[c],
      ) as Vector;
      const block = curved ? product(turn.slope, back[i]) : new Float64Array(9);
      for (let c = 0; c < 3; c++) block[4 * c] += diagonal[i];
      found.push(g);
      blocks.push(block);
      // a maximum that a number which is none cannot hide in
      for (const x of g) error = Math.abs(x) <= error ? error : Math.abs(x);
    }
    return { found, blocks, error };
  };
  const moved = (w: Vector[], steps: Vector[]) =>
    w.map((v, k) => (k > 0 && k <= inner ? add(v, steps[k - 1]) : v));

  // without the quadratic part the diagonal dominates, and there is always an answer
  const flat = gap(velocities, false);
  let best = moved(velocities, solveTridiagonal(lower, flat.blocks, upper, flat.found));
  let state = gap(best, true);
  const small = 16 * Number.EPSILON * Math.max(...pull.map((v) => Math.max(...v.map(Math.abs))));
  for (let n = 0; n < NEWTON_STEPS && state.error > small; n++) {
    const tried = moved(best, solveTridiagonal(lower, state.blocks, upper, state.found));
    const next = gap(tried, true);
    if (!(next.error < state.error)) break;
    best = tried;
    state = next;
  }
  for (let k = 1; k <= inner; k++) velocities[k] = best[k];
}

/** x of lower[i] x[i-1] + diagonal[i] x[i] + upper[i] x[i+1] = right[i] for 3x3 blocks. */
function solveTridiagonal(lower: Matrix[], diagonal: Matrix[], upper: Matrix[], right: Vector[]): Vector[] {
  const count = right.length;
  const ahead: Matrix[] = [], known: Vector[] = [];
  for (let i = 0; i < count; i++) {
    let block = diagonal[i], rest = right[i];
    if (i > 0) {
      const below = product(lower[i], ahead[i - 1]);
      block = block.map((x, n) => x - below[n]);
      rest = add(rest, scale(apply(lower[i], known[i - 1]), -1));
    }
    const inverse = inverted(block);
    ahead.push(product(inverse, upper[i]));
    known.push(apply(inverse, rest));
  }
  for (let i = count - 2; i >= 0; i--) known[i] = add(known[i], scale(apply(ahead[i], known[i + 1]), -1));
  return known;
}

// --- derivatives of the exponential map ----------------------------------------------------------------------------------

// series of t = angle²: (1 - sin x / x) / x², its slope by x², and (1 - (x/2) cot(x/2)) / x² by (x/2)²
const B = [1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800];
const B_SLOPE = [-1 / 120, 2 / 5040, -3 / 362880, 4 / 39916800, -5 / 6227020800, 6 / 1307674368000];
const C = [1 / 12, 1 / 180, 1 / 1890, 1 / 18900, 1 / 187110, 691 / 1277025750];
const SINC_SLOPE = [-1 / 3, 1 / 30, -1 / 840, 1 / 45360, -1 / 3991680, 1 / 518918400];

const polynomial = (coefficients: number[], t: number) => coefficients.reduceRight((total, c) => c + t * total, 0);

function sinc(x: number): number {
  const t = x * x;
  return t < 1e-3 ? 1 - t / 6 + (t * t) / 120 - (t * t * t) / 5040 : Math.sin(x) / x;
}

/** (cos(x) - sin(x)/x) / x² of x² */
function sincSlope(t: number): number {
  if (t < 0.04) return polynomial(SINC_SLOPE, t);
  const x = Math.sqrt(t);
  return (Math.cos(x) - Math.sin(x) / x) / t;
}

function coefficients(r: Vector): { a: number; b: number; c: number; aSlope: number; bSlope: number } {
  const t = r[0] * r[0] + r[1] * r[1] + r[2] * r[2];
  const half = sinc(Math.sqrt(t) / 2);
  const small = t < 0.04;
  const b = small ? polynomial(B, t) : (1 - sinc(Math.sqrt(t))) / t;
  return {
    a: (half * half) / 2,
    b,
    c: small ? polynomial(C, t / 4) : (1 - Math.cos(Math.sqrt(t) / 2) / half) / t,
    aSlope: (half * sincSlope(t / 4)) / 8,
    bSlope: small ? polynomial(B_SLOPE, t) : -(sincSlope(t) / 2 + b) / t,
  };
}

/** J with angular velocity (in the turning frame) = J(r) dr/dt: 1 - a [r] + b [r]². */
function jacobian(r: Vector): Matrix {
  const { a, b } = coefficients(r);
  return combined(skew(r), -a, b);
}

function inverseJacobian(r: Vector): Matrix {
  return combined(skew(r), 0.5, coefficients(r).c);
}

/** (dJ/dt) p at r where dr/dt = p, and its derivative by p. */
function turning(r: Vector, p: Vector): { value: Vector; slope: Matrix } {
  const { b, aSlope, bSlope } = coefficients(r);
  const rp = cross(r, p);
  const along = r[0] * p[0] + r[1] * p[1] + r[2] * p[2];
  const bent = add(scale(cross(r, rp), bSlope), scale(rp, -aSlope));
  const k = skew(r), kk = product(k, k), kpk = product(skew(p), k), krp = skew(rp);
  const slope = new Float64Array(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) {
      const n = 3 * i + j;
      slope[n] = 2 * bent[i] * r[j] + 2 * along * (bSlope * kk[n] - aSlope * k[n]) + b * (kpk[n] - krp[n]);
    }
  return { value: add(scale(bent, 2 * along), scale(cross(p, rp), b)), slope };
}

const skew = (v: Vector): Matrix => Float64Array.of(0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0);
const scale = (v: Vector, s: number): Vector => [s * v[0], s * v[1], s * v[2]];
const add = (a: Vector, b: Vector): Vector => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const cross = (a: Vector, b: Vector): Vector => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const scaled = (m: Matrix, s: number): Matrix => m.map((x) => s * x);

function apply(m: Matrix, v: Vector): Vector {
  return [0, 3, 6].map((i) => m[i] * v[0] + m[i + 1] * v[1] + m[i + 2] * v[2]) as Vector;
}

function product(a: Matrix, b: Matrix): Matrix {
  const out = new Float64Array(9);
  for (let i = 0; i < 9; i += 3)
    for (let j = 0; j < 3; j++) out[i + j] = a[i] * b[j] + a[i + 1] * b[j + 3] + a[i + 2] * b[j + 6];
  return out;
}

/** 1 + s k + t k² */
function combined(k: Matrix, s: number, t: number): Matrix {
  const out = product(k, k);
  for (let n = 0; n < 9; n++) out[n] = (n % 4 === 0 ? 1 : 0) + s * k[n] + t * out[n];
  return out;
}

function inverted(m: Matrix): Matrix {
  const [a, b, c, d, e, f, g, h, i] = m;
  const A = e * i - f * h, D = f * g - d * i, G = d * h - e * g;
  const s = 1 / (a * A + b * D + c * G);
  return Float64Array.of(
    s * A, s * (c * h - b * i), s * (b * f - c * e),
    s * D, s * (a * i - c * g), s * (c * d - a * f),
    s * G, s * (b * g - a * h), s * (a * e - b * d),
  );
}
