// One span of a BEZIER curve: handles in seconds and value from their keys, as keypose.model.Curve describes them.

/** How much of a handle of dt seconds counts in a span: all, or as far as the span in its own direction. */
export function handleShare(dt: number, span: number): number {
  const length = Math.abs(dt);
  return length > span ? span / length : 1;
}

/** The parameter u in 0..1 where the Bezier of x = 0, a, b, 1 (a, b in 0..1, so that it never runs back) reaches x. */
export function bezierParameter(a: number, b: number, x: number): number {
  if (x <= 0) return 0;
  if (x >= 1) return 1;
  // from the nearer end, where the polynomial loses no digits
  if (x > bezierAt(0.5, 0, a, b, 1)) return 1 - solve(1 - b, 1 - a, 1 - x);
  return solve(a, b, x);
}

function solve(a: number, b: number, x: number): number {
  const c1 = 3 * a, c2 = 3 * (b - 2 * a), c3 = 1 - 3 * b + 3 * a;
  let low = 0, high = 0.5;
  let u = Math.min(x, 0.5);
  for (let step = 0; step < 60; step++) {
    const error = ((c3 * u + c2) * u + c1) * u - x;
    if (error === 0) return u;
    if (error > 0) high = u;
    else low = u;
    const slope = (3 * c3 * u + 2 * c2) * u + c1;
    let next = u - error / slope;
    // Newton's step where it stays in the bracket, else half of it
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (Math.abs(next - u) <= 1e-17 + 2.2e-16 * u) return next;
    u = next;
  }
  return u;
}

/** The cubic of four control numbers at u. */
export function bezierAt(u: number, p0: number, p1: number, p2: number, p3: number): number {
  const v = 1 - u;
  return v * v * v * p0 + 3 * v * u * (v * p1 + u * p2) + u * u * u * p3;
}

/** Value at the share s of a span: handles (dt, dv) after its first and before its last key, shortened to the span. */
export function bezierValue(s: number, span: number, v0: number, dt0: number, dv0: number, dt1: number, dv1: number, v1: number): number {
  const share0 = handleShare(dt0, span), share1 = handleShare(dt1, span);
  const u = bezierParameter((share0 * dt0) / span, 1 + (share1 * dt1) / span, s);
  return bezierAt(u, v0, v0 + share0 * dv0, v1 + share1 * dv1, v1);
}
