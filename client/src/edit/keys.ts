// Operations on the keys of curves. Nothing is changed in place: a curve goes in, a curve comes out, and arrays that an
// operation leaves alone are the same arrays.

import { bezierParameter, handleShare } from "../anim/bezier";
import { Curve, keyBefore, keyFrom } from "../anim/curve";
import { Mode, Tangent, type EditCurve, type Kind } from "./contract";
import {
  allKeys,
  copied,
  draftOf,
  merge,
  pick,
  SAME_TIME,
  scratchFor,
  sliced,
  spareOf,
  without,
  withHandles,
  withTangents,
  withTypes,
  type Keyed,
  type Spare,
} from "./key-arrays";
import { refresh, refreshTangents, type Draft } from "./tangents";

export { compact, SAME_TIME, withHandles, withTangents, type Keyed } from "./key-arrays";
export { refreshTangents } from "./tangents";

/** time' = scaleTime * time + shiftTime, value' = scaleValue * value + shiftValue (one for all components or one for each). */
export interface Transform {
  readonly scaleTime: number;
  readonly shiftTime: number;
  readonly scaleValue: number;
  readonly shiftValue: number | ArrayLike<number>;
}

export const STILL: Transform = { scaleTime: 1, shiftTime: 0, scaleValue: 1, shiftValue: 0 };

/** The modes that a kind of curve may have. */
export function modesOf(kind: Kind): readonly Mode[] {
  if (kind === "boolean") return [Mode.Step];
  if (kind === "rotation") return [Mode.Step, Mode.Linear, Mode.Hermite, Mode.Squad, Mode.SphericalBezier, Mode.LogCubic];
  return [Mode.Step, Mode.Linear, Mode.Hermite, Mode.Bezier];
}

/** Bring the sides of keys and of their neighbours up to date, in place. */
function refreshAround(draft: Draft, indices: ArrayLike<number>): void {
  if (!draft.types) return;
  let n = 0;
  while (n < indices.length) {
    const first = indices[n];
    let last = first;
    // one run for keys whose neighbourhoods touch
    while (n + 1 < indices.length && indices[n + 1] <= last + 3) last = indices[++n];
    refresh(draft, first - 1, last + 1);
    n++;
  }
}

function refreshed({ curve, indices }: Keyed): Keyed {
  return { curve: refreshTangents(curve), indices };
}

// ---- move and scale --------------------------------------------------------------------------------------------------

/**
 * Move and scale keys. `masks` holds for every index the bits of the components whose values change (null: all). Keys that
 * land on others take their place; a negative scale of time turns the order round. A curve that nobody looks at any more
 * may be given as `spare`: its arrays are written again, so that dragging thousands of keys makes no garbage.
 */
export function transformKeys(curve: EditCurve, indices: Uint32Array, transform: Transform, masks: Uint8Array | null = null, spare: EditCurve | null = null): Keyed {
  const { scaleTime, shiftTime, scaleValue, shiftValue } = transform;
  const inTime = scaleTime !== 1 || shiftTime !== 0, inValue = scaleValue !== 1 || shiftValue !== 0;
  if (indices.length === 0 || (!inTime && !inValue)) return { curve, indices };
  const ordered = !inTime || (scaleTime > 0 && staysInOrder(curve.times, indices, scaleTime, shiftTime));
  const own = spareOf(spare, curve);
  const draft = changed(curve, indices, transform, masks, ordered ? own : scratchFor(curve));
  if (!ordered) return rearranged(draft, indices, scaleTime < 0 ? indices.toReversed() : indices, scaleTime < 0, own);
  refreshAround(draft, indices);
  return { curve: draft, indices };
}

/** Put keys that have new times (`moved`, in the order of those) among the others, whose place they take. */
function rearranged(draft: Draft, indices: Uint32Array, moved: ArrayLike<number>, backwards: boolean, spare: Spare | null = null): Keyed {
  if (backwards) turnSides(draft, indices);
  const { times } = draft, count = times.length;
  const order = new Uint32Array(count), places = new Uint32Array(moved.length);
  const own = new Uint8Array(count);
  for (let n = 0; n < indices.length; n++) own[indices[n]] = 1;
  let i = 0, j = 0, n = 0, m = 0;
  for (;;) {
    while (i < count && own[i]) i++;
    if (j < moved.length && (i >= count || times[moved[j]] <= times[i] + SAME_TIME)) {
      const k = moved[j++], last = n > 0 ? order[n - 1] : -1;
      if (last >= 0 && times[k] - times[last] <= SAME_TIME) {
        n--;
        // of moved keys that fall together the last stays
        if (own[last]) m--;
      }
      places[m++] = n;
      order[n++] = k;
    } else if (i < count) {
      const last = n > 0 ? order[n - 1] : -1;
      if (last >= 0 && own[last] && times[i] - times[last] <= SAME_TIME) i++;
      else order[n++] = i++;
    } else break;
  }
  const curve: Draft = pick(draft, order.subarray(0, n), spare)!;
  const kept = places.slice(0, m);
  // from the first key that is another one to the last, with their neighbours
  let first = 0, last = 0;
  while (first < n && order[first] === first && !own[first]) first++;
  while (last < n && order[n - 1 - last] === count - 1 - last && !own[count - 1 - last]) last++;
  refresh(curve, first - 1, n - last);
  return { curve, indices: kept };
}

/** Before is after: sides of keys that were turned round in time, and the modes of the spans between them, in place. */
function turnSides(draft: Draft, indices: Uint32Array): void {
  const { components: width, types, inTangents, outTangents, inHandles, outHandles } = draft;
  const swap = (a: Float64Array | null, b: Float64Array | null, from: number, to: number) => {
    for (let n = from; a && b && n < to; n++) [a[n], b[n]] = [b[n], a[n]];
  };
  const modes = draft.modes.slice();
  for (let n = 0; n < indices.length; n++) {
    const k = indices[n];
    swap(inTangents, outTangents, k * width, (k + 1) * width);
    swap(inHandles, outHandles, 2 * k * width, 2 * (k + 1) * width);
    // a span's mode belongs to the key that starts it, which is now the other one
    modes[k] = draft.modes[indices[n > 0 ? n - 1 : indices.length - 1]];
  }
  draft.modes = modes;
  if (!types) return;
  const turned = types.slice();
  for (const k of indices) [turned[2 * k], turned[2 * k + 1]] = [types[2 * k + 1], types[2 * k]];
  draft.types = turned;
}

function staysInOrder(times: Float64Array, indices: Uint32Array, scale: number, shift: number): boolean {
  const end = times.length - 1;
  for (let n = 0; n < indices.length; n++) {
    const k = indices[n], time = scale * times[k] + shift;
    const left = k === 0 ? -Infinity : n > 0 && indices[n - 1] === k - 1 ? scale * times[k - 1] + shift : times[k - 1];
    const right = k === end ? Infinity : n + 1 < indices.length && indices[n + 1] === k + 1 ? scale * times[k + 1] + shift : times[k + 1];
    if (time - left <= SAME_TIME || right - time <= SAME_TIME) return false;
  }
  return true;
}

/** Keys with new times and values where they stand; only arrays that change are copied. */
function changed(curve: EditCurve, indices: Uint32Array, transform: Transform, masks: Uint8Array | null, spare: Spare | null = null): Draft {
  const { scaleTime, shiftTime, scaleValue, shiftValue } = transform;
  const width = curve.components, inTime = scaleTime !== 1 || shiftTime !== 0, inValue = scaleValue !== 1 || shiftValue !== 0;
  const sides = scaleTime !== 1 || scaleValue !== 1 || curve.types !== null;
  const draft: Draft = {
    ...curve,
    times: inTime ? copied(curve.times, spare?.times) : curve.times,
    values: inValue ? copied(curve.values, spare?.values) : curve.values,
    inTangents: sides ? sliced(curve.inTangents, spare?.inTangents) : curve.inTangents,
    outTangents: sides ? sliced(curve.outTangents, spare?.outTangents) : curve.outTangents,
    inHandles: sides ? sliced(curve.inHandles, spare?.inHandles) : curve.inHandles,
    outHandles: sides ? sliced(curve.outHandles, spare?.outHandles) : curve.outHandles,
  };
  const { times, values, inTangents, outTangents, inHandles, outHandles } = draft;
  for (let n = 0; n < indices.length; n++) {
    const k = indices[n], mask = masks ? masks[n] : 255;
    if (inTime) times[k] = scaleTime * times[k] + shiftTime;
    for (let c = 0; c < width; c++) {
      const i = k * width + c, on = (mask >> c) & 1, grown = on ? scaleValue : 1;
      if (inValue && on) values[i] = scaleValue * values[i] + (typeof shiftValue === "number" ? shiftValue : shiftValue[c]);
      if (scaleTime === 1 && grown === 1) continue;
      if (inTangents && outTangents) {
        inTangents[i] *= grown / (scaleTime || 1);
        outTangents[i] *= grown / (scaleTime || 1);
      }
      if (inHandles && outHandles) {
        inHandles[2 * i] *= scaleTime;
        inHandles[2 * i + 1] *= grown;
        outHandles[2 * i] *= scaleTime;
        outHandles[2 * i + 1] *= grown;
      }
    }
    if (inValue && curve.kind === "rotation") unit(values, k * width, mask);
    if (inValue && curve.kind === "boolean") values[k] = values[k] >= 0.5 ? 1 : 0;
  }
  return draft;
}

/** A rotation stays one: what was not edited gives way. */
function unit(q: Float64Array, o: number, mask: number): void {
  let set = 0, other = 0;
  for (let c = 0; c < 4; c++) if ((mask >> c) & 1) set += q[o + c] * q[o + c]; else other += q[o + c] * q[o + c];
  if (set >= 1 || (mask & 15) === 15 || other === 0) {
    const s = 1 / Math.sqrt(set + ((mask & 15) === 15 || set < 1 ? other : 0) || 1);
    for (let c = 0; c < 4; c++) q[o + c] = (mask >> c) & 1 ? q[o + c] * s : 0;
    return;
  }
  const s = Math.sqrt((1 - set) / other);
  for (let c = 0; c < 4; c++) if (!((mask >> c) & 1)) q[o + c] *= s;
}

/** Keys at times of their own, as to whole frames. */
export function retimeKeys(curve: EditCurve, indices: Uint32Array, time: (time: number) => number): Keyed {
  if (indices.length === 0) return { curve, indices };
  const draft: Draft = draftOf(curve);
  for (const k of indices) draft.times[k] = time(curve.times[k]);
  return rearranged(draft, indices, [...indices].sort((a, b) => draft.times[a] - draft.times[b] || a - b), false);
}

/** The keys, and copies of them moved by some seconds; the copies are what is returned as worked on. */
export function duplicateKeys(curve: EditCurve, indices: Uint32Array, shiftTime: number): Keyed {
  if (indices.length === 0) return { curve, indices };
  const own = pick(curve, indices)!;
  return refreshed(merge(curve, changed(own, allKeys(own), { ...STILL, shiftTime }, null)));
}

/** From the first of these keys on, all. */
export function ripple(curve: EditCurve, indices: Uint32Array): Uint32Array {
  const first = indices.length > 0 ? indices[0] : curve.times.length;
  return Uint32Array.from({ length: curve.times.length - first }, (_, n) => first + n);
}

/** Null where no key is left. */
export function deleteKeys(curve: EditCurve, indices: Uint32Array): EditCurve | null {
  const rest = pick(curve, without(curve.times.length, indices));
  return rest && refreshTangents(rest);
}

// ---- one key ---------------------------------------------------------------------------------------------------------

/** Values at a time. */
export function valueAt(curve: EditCurve, time: number): Float64Array {
  const out = new Float64Array(curve.components);
  new Curve(curve).sample(time, out, 0);
  return out;
}

/**
 * A key more at a time, through which the curve goes as before: exactly where its span is of steps, lines or cubics. Sides
 * beside it that would follow their neighbours stay as they are from now on. Where the handles of a Bezier span overlap in
 * time it takes one more key in the middle to stay exact.
 */
export function insertKey(curve: EditCurve, time: number): Keyed {
  let next = curve;
  for (const middle of overlapMiddles(curve, time)) next = insertOne(next, middle).curve;
  return insertOne(next, time);
}

/** Times in the middle (u = 1/2) of the components of a Bezier span whose handles overlap. */
function overlapMiddles({ times, modes, inHandles, outHandles, components: width }: EditCurve, time: number): number[] {
  const k = keyBefore(times, time);
  if (k + 1 >= times.length || time <= times[0] || modes[k] !== Mode.Bezier || !inHandles || !outHandles) return [];
  const span = times[k + 1] - times[k], found: number[] = [];
  for (let c = 0; c < width; c++) {
    const first = Math.min(1, outHandles[2 * (k * width + c)] / span), last = 1 - Math.min(1, -inHandles[2 * ((k + 1) * width + c)] / span);
    const middle = times[k] + (span * (3 * first + 3 * last + 1)) / 8;
    if (first > last + 1e-12 && Math.abs(middle - time) > SAME_TIME) found.push(middle);
  }
  return found;
}

function insertOne(curve: EditCurve, time: number): Keyed {
  const { times, components: width } = curve;
  const near = keyFrom(times, time - SAME_TIME);
  if (near < times.length && Math.abs(times[near] - time) <= SAME_TIME) return { curve, indices: Uint32Array.of(near) };
  const inside = time > times[0] && time < times[times.length - 1];
  const k = keyBefore(times, time);
  const value = valueAt(curve, time);
  if (curve.kind === "rotation") unit(value, 0, 15);
  const one: Draft = { ...pick(curve, [k])!, times: Float64Array.of(time), values: value };
  if (!inside) {
    const { curve: longer, indices } = merge(curve, one);
    return refreshed({ curve: longer, indices });
  }
  const { curve: longer, indices } = merge(curve, one);
  const draft = draftOf(longer);
  const at = indices[0], mode = draft.modes[at];
  for (let c = 0; c < width; c++) {
    if (mode === Mode.Bezier) splitBezier(curve, draft, at, c);
    else if (mode === Mode.Hermite) splitHermite(curve, draft, at, c);
  }
  if (draft.types && (mode === Mode.Bezier || mode === Mode.Hermite)) {
    const { types } = draft;
    for (const [near, far] of [[2 * (at - 1) + 1, 2 * (at - 1)], [2 * (at + 1), 2 * (at + 1) + 1]]) {
      types[near] = types[near] === Tangent.Vector || types[near] === Tangent.Free ? Tangent.Free : Tangent.Aligned;
      // the other side would follow the new key, too
      if (types[far] === Tangent.Auto || types[far] === Tangent.Clamped) types[far] = Tangent.Aligned;
    }
    types[2 * at] = types[2 * at + 1] = Tangent.Aligned;
  }
  return { curve: draft, indices };
}

function splitHermite(curve: EditCurve, draft: Draft, at: number, c: number): void {
  const width = curve.components, i = (at - 1) * width + c, j = i + width;
  const start = curve.times[at - 1], span = curve.times[at] - start, u = (draft.times[at] - start) / span, v = 1 - u;
  const slope =
    6 * u * v * ((curve.values[j] - curve.values[i]) / span) +
    v * (1 - 3 * u) * curve.outTangents![i] +
    u * (1 - 3 * v) * curve.inTangents![j];
  draft.inTangents![at * width + c] = draft.outTangents![at * width + c] = slope;
}

function splitBezier(curve: EditCurve, draft: Draft, at: number, c: number): void {
  const width = curve.components, i = (at - 1) * width + c, j = i + width;
  const span = curve.times[at] - curve.times[at - 1], s = (draft.times[at] - curve.times[at - 1]) / span;
  const { outHandles, inHandles, values } = curve;
  const out = handleShare(outHandles![2 * i], span), back = handleShare(inHandles![2 * j], span);
  const x = [0, out * outHandles![2 * i], span + back * inHandles![2 * j], span];
  const y = [values[i], values[i] + out * outHandles![2 * i + 1], values[j] + back * inHandles![2 * j + 1], values[j]];
  const u = bezierParameter(x[1] / span, x[2] / span, s);
  const mix = (a: number, b: number) => a + u * (b - a);
  // De Casteljau
  const first = [mix(x[0], x[1]), mix(y[0], y[1])], middle = [mix(x[1], x[2]), mix(y[1], y[2])], third = [mix(x[2], x[3]), mix(y[2], y[3])];
  const left = [mix(first[0], middle[0]), mix(first[1], middle[1])], right = [mix(middle[0], third[0]), mix(middle[1], third[1])];
  const n = at * width + c, time = s * span, value = draft.values[n];
  const set = (handles: Float64Array, o: number, dt: number, dv: number, sign: number) => {
    handles[2 * o] = sign * Math.max(0, sign * dt);
    handles[2 * o + 1] = dv;
  };
  set(draft.outHandles!, n - width, first[0], first[1] - y[0], 1);
  set(draft.inHandles!, n, left[0] - time, left[1] - value, -1);
  set(draft.outHandles!, n, right[0] - time, right[1] - value, 1);
  set(draft.inHandles!, n + width, third[0] - span, third[1] - y[3], -1);
}

/**
 * One side (0 before, 1 after the key) of one component set by hand: seconds and value from the key to its handle. A side
 * that followed its neighbours becomes aligned, one that pointed to a neighbour free; the other side stays in line where
 * it is aligned.
 */
export function setHandle(curve: EditCurve, key: number, component: number, side: 0 | 1, seconds: number, value: number): EditCurve {
  const width = curve.components, n = key * width + component, end = curve.times.length - 1;
  const span = side === 0 ? (key > 0 ? curve.modes[key - 1] : curve.modes[0]) : curve.modes[Math.min(key, Math.max(0, end - 1))];
  const draft = draftOf(withTypes(curve));
  const types = draft.types!;
  const soft = (type: number) => (type === Tangent.Vector ? Tangent.Free : type === Tangent.Free ? Tangent.Free : Tangent.Aligned);
  types[2 * key + side] = soft(types[2 * key + side]);
  const other = (1 - side) as 0 | 1;
  const together = types[2 * key + side] === Tangent.Aligned;
  if (together) types[2 * key + other] = soft(types[2 * key + other]);
  const dt = side === 0 ? Math.min(0, seconds) : Math.max(0, seconds);
  if (draft.inHandles && draft.outHandles && span === Mode.Bezier) {
    const mine = side === 0 ? draft.inHandles : draft.outHandles, theirs = side === 0 ? draft.outHandles : draft.inHandles;
    mine[2 * n] = dt;
    mine[2 * n + 1] = value;
    if (together && types[2 * key + other] === Tangent.Aligned) {
      if (dt !== 0) theirs[2 * n + 1] = (value / dt) * theirs[2 * n];
      else if (value !== 0) {
        // straight up: as long as it was, on the other side
        const reach = Math.abs(theirs[2 * n + 1]) || Math.abs(value);
        theirs[2 * n] = 0;
        theirs[2 * n + 1] = -Math.sign(value) * reach;
      }
    }
  }
  if (draft.inTangents && draft.outTangents && dt !== 0) {
    (side === 0 ? draft.inTangents : draft.outTangents)[n] = value / dt;
    if (together && types[2 * key + other] === Tangent.Aligned) (side === 0 ? draft.outTangents : draft.inTangents)[n] = value / dt;
  }
  return draft;
}

// ---- modes, types, ends ----------------------------------------------------------------------------------------------

/** The spans that start at these keys, in another mode. Hermite becomes Bezier exactly; lines and steps get soft sides. */
export function setMode(curve: EditCurve, indices: Uint32Array, mode: Mode): EditCurve {
  if (!modesOf(curve.kind).includes(mode)) return curve;
  const cubic = mode === Mode.Bezier || mode === Mode.Hermite;
  let next = mode === Mode.Bezier ? withHandles(curve) : mode === Mode.Hermite ? withTangents(curve) : curve;
  if (cubic) next = withTypes(next);
  const draft = draftOf(next);
  const { types, times, components: width } = draft;
  for (const k of indices) {
    const old = draft.modes[k];
    draft.modes[k] = mode;
    if (!cubic || old === mode || k + 1 >= times.length) continue;
    const third = (times[k + 1] - times[k]) / 3;
    if (old === Mode.Hermite || old === Mode.Bezier) {
      for (let c = 0; c < width; c++)
        for (const [n, side] of [[k * width + c, 1], [(k + 1) * width + c, 0]] as const) {
          const tangents = side ? draft.outTangents : draft.inTangents, handles = side ? draft.outHandles : draft.inHandles;
          if (!tangents || !handles) continue;
          if (mode === Mode.Bezier) {
            handles[2 * n] = side ? third : -third;
            handles[2 * n + 1] = handles[2 * n] * tangents[n];
          } else if (handles[2 * n] !== 0) tangents[n] = handles[2 * n + 1] / handles[2 * n];
        }
      continue;
    }
    if (types![2 * k + 1] === Tangent.Free) types![2 * k + 1] = Tangent.Clamped;
    if (types![2 * k + 2] === Tangent.Free) types![2 * k + 2] = Tangent.Clamped;
  }
  refresh(draft, 0, times.length - 1);
  return draft;
}

/** Sides of keys (0 before, 1 after, both where it is not said) of another type; spans of lines and steps become Bezier. */
export function setType(curve: EditCurve, indices: Uint32Array, type: Tangent, side?: 0 | 1): EditCurve {
  const smooth: Mode = curve.kind === "rotation" ? Mode.Hermite : Mode.Bezier;
  if (!modesOf(curve.kind).includes(smooth)) return curve;
  const flat = (k: number) => k >= 0 && k + 1 < curve.times.length && curve.modes[k] !== Mode.Bezier && curve.modes[k] !== Mode.Hermite;
  const spans = new Set<number>();
  for (const k of indices) {
    if (side !== 1 && flat(k - 1)) spans.add(k - 1);
    if (side !== 0 && flat(k)) spans.add(k);
  }
  const draft = draftOf(withTypes(spans.size > 0 ? setMode(curve, Uint32Array.from(spans).sort(), smooth) : curve));
  const types = draft.types!;
  for (const k of indices) {
    if (side !== 1) types[2 * k] = type;
    if (side !== 0) types[2 * k + 1] = type;
    if (type === Tangent.Aligned) align(draft, k);
  }
  refresh(draft, 0, draft.times.length - 1);
  return draft;
}

/** Both sides of a key in one line: the mean of their directions. */
function align(draft: Draft, k: number): void {
  const { components: width, inHandles, outHandles, inTangents, outTangents } = draft;
  for (let c = 0; c < width; c++) {
    const n = k * width + c;
    if (inTangents && outTangents) inTangents[n] = outTangents[n] = (inTangents[n] + outTangents[n]) / 2;
    if (!inHandles || !outHandles || inHandles[2 * n] === 0 || outHandles[2 * n] === 0) continue;
    const slope = (inHandles[2 * n + 1] / inHandles[2 * n] + outHandles[2 * n + 1] / outHandles[2 * n]) / 2;
    inHandles[2 * n + 1] = slope * inHandles[2 * n];
    outHandles[2 * n + 1] = slope * outHandles[2 * n];
  }
}

export function setExtrapolation(curve: EditCurve, before: string | null, after: string | null): EditCurve {
  return { ...curve, before: before ?? curve.before, after: after ?? curve.after };
}

/** Handles of the spans from each of these keys to the next, as shares of span and change: CSS's cubic-bezier(x1, y1, x2, y2). */
export function setEase(curve: EditCurve, indices: Uint32Array, ease: readonly [number, number, number, number]): EditCurve {
  if (!modesOf(curve.kind).includes(Mode.Bezier)) return curve;
  const draft = draftOf(withTypes(withHandles(curve)));
  const { times, values, components: width, types } = draft;
  const [x1, y1, x2, y2] = ease;
  for (const k of indices) {
    if (k + 1 >= times.length) continue;
    draft.modes[k] = Mode.Bezier;
    types![2 * k + 1] = types![2 * k + 2] = Tangent.Free;
    const span = times[k + 1] - times[k];
    for (let c = 0; c < width; c++) {
      const n = k * width + c, m = n + width, change = values[m] - values[n];
      draft.outHandles![2 * n] = x1 * span;
      draft.outHandles![2 * n + 1] = y1 * change;
      draft.inHandles![2 * m] = (x2 - 1) * span;
      draft.inHandles![2 * m + 1] = (y2 - 1) * change;
    }
  }
  refresh(draft, 0, times.length - 1);
  return draft;
}

/** Named eases, as cubic Beziers over a span. */
export const EASES: Readonly<Record<string, readonly [number, number, number, number]>> = {
  "Slow in": [0.42, 0, 1, 1],
  "Slow out": [0, 0, 0.58, 1],
  "Slow in and out": [0.42, 0, 0.58, 1],
  "Strong in": [0.7, 0, 0.84, 0],
  "Strong out": [0.16, 1, 0.3, 1],
  "Strong in and out": [0.87, 0, 0.13, 1],
  Anticipate: [0.36, 0, 0.66, -0.56],
  Overshoot: [0.34, 1.56, 0.64, 1],
};

// ---- copy and paste --------------------------------------------------------------------------------------------------

/** Copied keys; times of all count from the first of them. */
export interface Clipboard {
  readonly length: number;
  readonly curves: readonly EditCurve[];
}

export function copyKeys(picked: readonly { readonly curve: EditCurve; readonly indices: Uint32Array }[]): Clipboard | null {
  const curves = picked.flatMap(({ curve, indices }) => pick(curve, indices) ?? []);
  if (curves.length === 0) return null;
  const start = Math.min(...curves.map((c) => c.times[0])), end = Math.max(...curves.map((c) => c.times[c.times.length - 1]));
  return { length: end - start, curves: curves.map((c) => ({ ...c, times: c.times.map((t) => t - start) })) };
}

export interface PasteOptions {
  /** Seconds where the first of all keys goes. */
  readonly at: number;
  /** Backwards in time. */
  readonly mirrored?: boolean;
  /** Values moved so that the first goes on from the curve. */
  readonly offset?: boolean;
  /** Keys of the curve that lie between the first and the last of the copy are taken away. */
  readonly overwrite?: boolean;
}

/** Copied keys of one channel put into a curve of it (or one like it), or as a new curve of `channel`. */
export function pasteKeys(curve: EditCurve | null, source: EditCurve, length: number, channel: EditCurve["channel"], options: PasteOptions): Keyed {
  const { at, mirrored = false, offset = false, overwrite = false } = options;
  const moved = transformKeys(source, allKeys(source), { ...STILL, scaleTime: mirrored ? -1 : 1, shiftTime: mirrored ? at + length : at });
  let own: EditCurve = { ...moved.curve, channel };
  if (offset && curve && curve.kind !== "rotation" && curve.kind !== "boolean") {
    const there = valueAt(curve, own.times[0]), first = own.values.slice(0, own.components), width = own.components;
    own = { ...own, values: own.values.map((v, n) => v + there[n % width] - first[n % width]) };
  }
  let base = curve;
  if (base && overwrite) {
    const { times } = base;
    const from = keyFrom(times, own.times[0] - SAME_TIME), to = keyFrom(times, own.times[own.times.length - 1] + SAME_TIME);
    base = pick(base, without(times.length, Uint32Array.from({ length: Math.max(0, to - from) }, (_, n) => from + n)));
  }
  const ends = base ?? curve;
  return refreshed(merge(base, ends ? { ...own, before: ends.before, after: ends.after } : own));
}
