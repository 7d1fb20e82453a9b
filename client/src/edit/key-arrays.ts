// The arrays of curves: picking keys, joining curves, and writing again into memory that nobody looks at any more.

import { Mode, type EditCurve } from "./contract";
import type { Draft } from "./tangents";

/** Keys nearer than this are one key: less than a thousandth of a frame. */
export const SAME_TIME = 2e-5;

/** A curve and where the keys that were worked on are in it. */
export interface Keyed {
  readonly curve: EditCurve;
  readonly indices: Uint32Array;
}

export function allKeys(curve: EditCurve): Uint32Array {
  return Uint32Array.from({ length: curve.times.length }, (_, k) => k);
}

/** Indices that are not among others (both sorted). */
export function without(count: number, indices: ArrayLike<number>): Uint32Array {
  const out = new Uint32Array(count - indices.length);
  let taken = 0, n = 0;
  for (let k = 0; k < count; k++) {
    if (taken < indices.length && indices[taken] === k) taken++;
    else out[n++] = k;
  }
  return out;
}

type Numbers = Float64Array | Uint8Array;

function rows<A extends Numbers>(array: A, indices: ArrayLike<number>, width: number, spare?: A | null): A {
  const count = indices.length;
  const out = fitting(array, count * width, spare);
  for (let n = 0; n < count; ) {
    // keys in a row are copied at once
    let end = n + 1;
    while (end < count && indices[end] === indices[end - 1] + 1) end++;
    (out as Float64Array).set(array.subarray(indices[n] * width, (indices[end - 1] + 1) * width) as Float64Array, n * width);
    n = end;
  }
  return out;
}

/** An array of so many numbers, in the memory of `spare` where that is large enough. */
function fitting<A extends Numbers>(like: A, length: number, spare: A | null | undefined): A {
  const make = like.constructor as { new (n: number): A; new (buffer: ArrayBufferLike, at: number, n: number): A };
  if (!spare || spare.buffer.byteLength < length * like.BYTES_PER_ELEMENT) return new make(length);
  return spare.length === length ? spare : new make(spare.buffer, 0, length);
}

const ARRAYS = ["times", "values", "modes", "inTangents", "outTangents", "inHandles", "outHandles", "types"] as const;
/** Arrays that may be written again. */
export type Spare = { -readonly [Field in (typeof ARRAYS)[number]]?: EditCurve[Field] };

/** The arrays of a curve that nobody looks at any more, without those that it shares with one that somebody does. */
export function spareOf(old: EditCurve | null, curve: EditCurve): Spare | null {
  if (!old) return null;
  const out: Record<string, Numbers> = {};
  for (const name of ARRAYS) {
    const array = old[name];
    if (array && array.buffer !== curve[name]?.buffer) out[name] = array;
  }
  return out as Spare;
}

/** The same curve with arrays that hold no more memory than they need; those of `base` stay what they are. */
export function compact(curve: EditCurve, base: EditCurve): EditCurve {
  const out: Draft = { ...curve };
  for (const name of ARRAYS) {
    const array = curve[name];
    if (array && array !== base[name] && array.buffer.byteLength !== array.byteLength) (out as Record<string, unknown>)[name] = array.slice();
  }
  return out;
}

/** Only these keys (indices in increasing order), as a curve of their own; null of none. */
export function pick(curve: EditCurve, indices: ArrayLike<number>, spare: Spare | null = null): EditCurve | null {
  if (indices.length === 0) return null;
  const width = curve.components;
  const of = <A extends Numbers>(array: A | null, size: number, into: A | null | undefined) => array && rows(array, indices, size, into);
  return {
    ...curve,
    times: of(curve.times, 1, spare?.times)!,
    values: of(curve.values, width, spare?.values)!,
    modes: of(curve.modes, 1, spare?.modes)!,
    inTangents: of(curve.inTangents, width, spare?.inTangents),
    outTangents: of(curve.outTangents, width, spare?.outTangents),
    inHandles: of(curve.inHandles, 2 * width, spare?.inHandles),
    outHandles: of(curve.outHandles, 2 * width, spare?.outHandles),
    types: of(curve.types, 2, spare?.types),
  };
}

const scratch = new Map<string, Spare>();

/** Memory for what lasts no longer than one operation, for curves of this shape. */
export function scratchFor(curve: EditCurve): Spare {
  const shape = `${curve.times.length}/${curve.components}`;
  let found = scratch.get(shape);
  if (!found) {
    if (scratch.size > 64) scratch.clear();
    const numbers = curve.values.length, half = () => new Float64Array(numbers), whole = () => new Float64Array(2 * numbers);
    found = { times: new Float64Array(curve.times.length), values: half(), inTangents: half(), outTangents: half(), inHandles: whole(), outHandles: whole() };
    scratch.set(shape, found);
  }
  return found;
}

/** A copy that may be written; in the memory of `spare` where that fits. */
export function copied<A extends Numbers>(array: A, spare: A | null | undefined): A {
  const out = fitting(array, array.length, spare);
  (out as Float64Array).set(array as Float64Array);
  return out;
}

export const sliced = <A extends Numbers>(array: A | null, spare?: A | null): A | null => array && copied(array, spare);

/** A copy whose arrays may be written. */
export function draftOf(curve: EditCurve): Draft {
  return {
    ...curve,
    times: curve.times.slice(),
    values: curve.values.slice(),
    modes: curve.modes.slice(),
    inTangents: sliced(curve.inTangents),
    outTangents: sliced(curve.outTangents),
    inHandles: sliced(curve.inHandles),
    outHandles: sliced(curve.outHandles),
    types: sliced(curve.types),
  };
}

/** A curve that has handles: those of Hermite spans describe the same cubic, all others point to their neighbours. */
export function withHandles(curve: EditCurve): EditCurve {
  if (curve.inHandles) return curve;
  const { times, values, components: width, modes, inTangents, outTangents } = curve;
  const count = times.length;
  const inHandles = new Float64Array(2 * values.length), outHandles = new Float64Array(2 * values.length);
  for (let k = 0; k + 1 < count; k++) {
    const third = (times[k + 1] - times[k]) / 3, hermite = modes[k] === Mode.Hermite && inTangents && outTangents;
    for (let c = 0; c < width; c++) {
      const n = k * width + c, m = n + width;
      // level beyond the ends, as far as on the other side
      if (k === 0) inHandles[2 * n] = -third;
      if (k + 2 === count) outHandles[2 * m] = third;
      const secant = (values[m] - values[n]) / (3 * third);
      outHandles[2 * n] = third;
      outHandles[2 * n + 1] = third * (hermite ? outTangents[n] : secant);
      inHandles[2 * m] = -third;
      inHandles[2 * m + 1] = -third * (hermite ? inTangents[m] : secant);
    }
  }
  return { ...curve, inHandles, outHandles };
}

/** A curve that has tangents: of Bezier spans the slopes of their handles, of all others towards their neighbours. */
export function withTangents(curve: EditCurve): EditCurve {
  if (curve.inTangents) return curve;
  const { times, values, components: width, modes, inHandles, outHandles } = curve;
  const inTangents = new Float64Array(values.length), outTangents = new Float64Array(values.length);
  for (let k = 0; k + 1 < times.length; k++) {
    const span = times[k + 1] - times[k], bezier = modes[k] === Mode.Bezier && inHandles && outHandles;
    for (let c = 0; c < width; c++) {
      const n = k * width + c, m = n + width;
      const secant = (values[m] - values[n]) / span;
      const slope = (handles: Float64Array, at: number) => (handles[2 * at] === 0 ? secant : handles[2 * at + 1] / handles[2 * at]);
      outTangents[n] = bezier ? slope(outHandles, n) : secant;
      inTangents[m] = bezier ? slope(inHandles, m) : secant;
    }
  }
  return { ...curve, inTangents, outTangents };
}

export const withTypes = (curve: EditCurve): EditCurve => (curve.types ? curve : { ...curve, types: new Uint8Array(2 * curve.times.length) });

/** Two curves of one channel as one; where keys coincide, those of `added` win. Sides are not brought up to date. */
export function merge(base: EditCurve | null, added: EditCurve): Keyed {
  if (!base) return { curve: added, indices: allKeys(added) };
  const even = (a: EditCurve, b: EditCurve) => {
    let out = a;
    if (b.inHandles) out = withHandles(out);
    if (b.inTangents) out = withTangents(out);
    return b.types ? withTypes(out) : out;
  };
  const a = even(base, added), b = even(added, base);
  const na = a.times.length, nb = b.times.length;
  // keys of `a` by their index, those of `b` by na + their index
  const order = new Uint32Array(na + nb), indices = new Uint32Array(nb);
  let i = 0, j = 0, n = 0;
  while (i < na || j < nb) {
    if (j < nb && (i >= na || b.times[j] <= a.times[i] + SAME_TIME)) {
      if (n > 0 && order[n - 1] < na && Math.abs(a.times[order[n - 1]] - b.times[j]) <= SAME_TIME) n--;
      indices[j] = n;
      order[n++] = na + j++;
    } else if (j > 0 && Math.abs(a.times[i] - b.times[j - 1]) <= SAME_TIME) i++;
    else order[n++] = i++;
  }
  const used = order.subarray(0, n);
  const width = base.components;
  const join = <A extends Numbers>(from: A | null, other: A | null, size: number): A | null => {
    if (!from || !other) return null;
    const out = new (from.constructor as new (n: number) => A)(n * size);
    for (let k = 0, o = 0; k < n; k++) {
      const mine = used[k] < na, source = mine ? from : other, at = (mine ? used[k] : used[k] - na) * size;
      for (let c = 0; c < size; c++) out[o++] = source[at + c];
    }
    return out;
  };
  return {
    curve: {
      ...base,
      times: join(a.times, b.times, 1)!,
      values: join(a.values, b.values, width)!,
      modes: join(a.modes, b.modes, 1)!,
      inTangents: join(a.inTangents, b.inTangents, width),
      outTangents: join(a.outTangents, b.outTangents, width),
      inHandles: join(a.inHandles, b.inHandles, 2 * width),
      outHandles: join(a.outHandles, b.outHandles, 2 * width),
      types: join(a.types, b.types, 2),
    },
    indices,
  };
}
