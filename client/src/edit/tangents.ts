// What keeps tangents and handles up to date, by the types of their sides: the rules of keypose.editing.tangents.

import { Tangent, type EditCurve } from "./contract";

/** A curve that is being made, whose arrays may be written. */
export type Draft = { -readonly [Field in keyof EditCurve]: EditCurve[Field] };

/** The same curve with sides brought up to date that are VECTOR, AUTO, CLAMPED or FLAT. */
export function refreshTangents(curve: EditCurve, first = 0, last = curve.times.length - 1): EditCurve {
  if (!curve.types || (!curve.inHandles && !curve.inTangents)) return curve;
  const draft: Draft = {
    ...curve,
    inTangents: curve.inTangents && curve.inTangents.slice(),
    outTangents: curve.outTangents && curve.outTangents.slice(),
    inHandles: curve.inHandles && curve.inHandles.slice(),
    outHandles: curve.outHandles && curve.outHandles.slice(),
  };
  refresh(draft, first, last);
  return draft;
}

/** `refreshTangents` in place, for keys first to last. */
export function refresh(draft: Draft, first: number, last: number): void {
  const { types, times, components: width } = draft;
  if (!types) return;
  const end = times.length - 1;
  for (let k = Math.max(0, first); k <= Math.min(end, last); k++) {
    const before = k > 0 ? times[k] - times[k - 1] : end > 0 ? times[1] - times[0] : 0;
    const after = k < end ? times[k + 1] - times[k] : before;
    for (let side = 0; side < 2; side++) {
      const type = types[2 * k + side];
      if (type === Tangent.Free || type === Tangent.Aligned) continue;
      const tangents = side === 0 ? draft.inTangents : draft.outTangents;
      const handles = side === 0 ? draft.inHandles : draft.outHandles;
      const reach = side === 0 ? -before / 3 : after / 3;
      for (let c = 0; c < width; c++) {
        const slope = slopeOf(draft, k, c, type, side);
        const n = k * width + c;
        if (tangents) tangents[n] = slope;
        if (handles) {
          handles[2 * n] = reach;
          handles[2 * n + 1] = reach * slope;
        }
      }
    }
  }
}

/** Slope per second of one component at a key, by the type of its side (0 before, 1 after). */
function slopeOf({ times, values, components: width }: Draft, k: number, c: number, type: number, side: number): number {
  if (type === Tangent.Flat) return 0;
  const end = times.length - 1, n = k * width + c;
  const hasBefore = k > 0, hasAfter = k < end;
  const before = hasBefore ? (values[n] - values[n - width]) / (times[k] - times[k - 1]) : 0;
  const after = hasAfter ? (values[n + width] - values[n]) / (times[k + 1] - times[k]) : 0;
  if (type === Tangent.Vector) return side === 0 ? (hasBefore ? before : after) : hasAfter ? after : before;
  if (!hasBefore || !hasAfter) return type === Tangent.Clamped ? 0 : hasBefore ? before : after;
  const slope = (values[n + width] - values[n - width]) / (times[k + 1] - times[k - 1]);
  if (type === Tangent.Auto) return slope;
  if (before * after <= 0) return 0;
  const limit = 3 * Math.min(Math.abs(before), Math.abs(after));
  return Math.max(-limit, Math.min(limit, slope));
}
