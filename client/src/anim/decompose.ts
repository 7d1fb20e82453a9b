// Position, rotation (wxyz) and scale of an affine matrix, for read-outs.

export function decompose(m: ArrayLike<number>): { position: number[]; rotation: number[]; scale: number[] } {
  const scale = [0, 3, 6].map((a) => Math.hypot(m[a], m[a + 1], m[a + 2]));
  const det =
    m[0] * (m[4] * m[8] - m[5] * m[7]) - m[3] * (m[1] * m[8] - m[2] * m[7]) + m[6] * (m[1] * m[5] - m[2] * m[4]);
  if (det < 0) scale[0] = -scale[0];
  // r(row, column)
  const r = (row: number, column: number) => (scale[column] === 0 ? (row === column ? 1 : 0) : m[3 * column + row] / scale[column]);
  const trace = r(0, 0) + r(1, 1) + r(2, 2);
  let q: number[];
  if (trace > 0) {
    const s = 2 * Math.sqrt(trace + 1);
    q = [s / 4, (r(2, 1) - r(1, 2)) / s, (r(0, 2) - r(2, 0)) / s, (r(1, 0) - r(0, 1)) / s];
  } else if (r(0, 0) > r(1, 1) && r(0, 0) > r(2, 2)) {
    const s = 2 * Math.sqrt(1 + r(0, 0) - r(1, 1) - r(2, 2));
    q = [(r(2, 1) - r(1, 2)) / s, s / 4, (r(0, 1) + r(1, 0)) / s, (r(0, 2) + r(2, 0)) / s];
  } else if (r(1, 1) > r(2, 2)) {
    const s = 2 * Math.sqrt(1 + r(1, 1) - r(0, 0) - r(2, 2));
    q = [(r(0, 2) - r(2, 0)) / s, (r(0, 1) + r(1, 0)) / s, s / 4, (r(1, 2) + r(2, 1)) / s];
  } else {
    const s = 2 * Math.sqrt(1 + r(2, 2) - r(0, 0) - r(1, 1));
    q = [(r(1, 0) - r(0, 1)) / s, (r(0, 2) + r(2, 0)) / s, (r(1, 2) + r(2, 1)) / s, s / 4];
  }
  return { position: [m[9], m[10], m[11]], rotation: q, scale };
}
