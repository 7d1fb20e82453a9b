// From a pose to keys: which channels a joint has, what they would hold now, and curves with a key more.

import { EULER_ORDER, eulerFromQuat, quatFromEuler } from "../anim/euler";
import type { Pose } from "../anim/rig";
import { SAME_TIME } from "./keys";
import { channelOf, Mode, Tangent, type ChannelId, type EditClip, type EditCurve, type Kind, type Property } from "./contract";

const FIELDS = { translation: ["translations", 3], rotation: ["rotations", 4], scale: ["scales", 3] } as const;
type LocalProperty = keyof typeof FIELDS;

/** A joint's local translation, rotation (wxyz) or scale. */
export function localOf(pose: Pose, joint: number, property: LocalProperty): number[] {
  const [field, width] = FIELDS[property];
  return [...pose[field].subarray(joint * width, (joint + 1) * width)];
}

export function setLocal(pose: Pose, joint: number, property: LocalProperty, value: ArrayLike<number>): void {
  const [field, width] = FIELDS[property];
  for (let c = 0; c < width; c++) pose[field][joint * width + c] = value[c];
}

export function orderOf(clip: EditClip | null, target: string): string {
  return clip?.eulerOrders[target] ?? EULER_ORDER;
}

/** The angles of a rotation that are nearest to others, so that a curve through both does not turn the long way. */
export function anglesNear(rotation: ArrayLike<number>, order: string, near: ArrayLike<number> | null): number[] {
  const out = [0, 0, 0];
  eulerFromQuat(rotation, 0, order, out, 0);
  if (!near) return out;
  const unwound = (angles: number[]) => angles.map((a, n) => a + 2 * Math.PI * Math.round((near[n] - a) / (2 * Math.PI)));
  const distance = (angles: number[]) => angles.reduce((sum, a, n) => sum + Math.abs(a - near[n]), 0);
  const first = unwound(out);
  const proper = order[0].toUpperCase() === order[2].toUpperCase();
  // the other triple that is the same rotation
  const second = unwound([out[0] + Math.PI, proper ? -out[1] : Math.PI - out[1], out[2] + Math.PI]);
  return distance(second) < distance(first) - 1e-9 ? second : first;
}

export function rotationOf(angles: ArrayLike<number>, order: string): number[] {
  const out = new Float64Array(4);
  quatFromEuler(angles, 0, order, out, 0);
  return [...out];
}

/** How a rotation that has no channel yet is keyed. */
export type RotationStyle = "euler" | "rotation";

/** The channels of a property that keys go to: those that are there, or one for the whole of it. */
export function channelsFor(clip: EditClip | null, target: string, property: Property, style: RotationStyle): ChannelId[] {
  const wanted = property === "rotation" || property === "euler" ? (["rotation", "euler"] as const) : ([property] as const);
  const found: ChannelId[] = [];
  for (const { channel } of clip?.curves.values() ?? [])
    if (channel.target === target && (wanted as readonly string[]).includes(channel.property)) found.push(channel);
  if (found.length === 0) return [channelOf(target, wanted.length > 1 ? style : property)];
  // separate curves for x, y, z: all three are keyed
  if (found.every((c) => c.component !== null)) return [0, 1, 2].map((n) => channelOf(target, found[0].property, n));
  return found;
}

export interface Local {
  readonly translation: ArrayLike<number>;
  readonly rotation: ArrayLike<number>;
  readonly scale: ArrayLike<number>;
}

/** What a channel of a joint would hold if it were keyed so; near is the value of the key before, for angles. */
export function valueOf(local: Local, order: string, channel: ChannelId, near: ArrayLike<number> | null): number[] {
  const { property, component } = channel;
  const whole = property === "euler" ? anglesNear(local.rotation, order, near) : Array.from(local[property as keyof Local]);
  if (property === "rotation" && near && whole.reduce((sum, v, c) => sum + v * near[c], 0) < 0) return whole.map((v) => -v);
  return component === null ? whole : [whole[component]];
}

function kindOf(channel: ChannelId): Kind {
  if (channel.component !== null || channel.property === "weight" || channel.property === "value") return "scalar";
  return channel.property === "rotation" ? "rotation" : channel.property === "euler" ? "euler" : "vector";
}

/** The key at a time, or -1. */
export function keyAt(curve: EditCurve, time: number): number {
  const { times } = curve;
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time - SAME_TIME) low = middle + 1;
    else high = middle;
  }
  return low < times.length && Math.abs(times[low] - time) <= SAME_TIME ? low : -1;
}

/** The key at or before a time, or the first. */
export function keyBefore(curve: EditCurve, time: number): number {
  const { times } = curve;
  let k = 0;
  while (k + 1 < times.length && times[k + 1] <= time + SAME_TIME) k++;
  return k;
}

export function valueAtKey(curve: EditCurve, k: number): Float64Array {
  return curve.values.subarray(k * curve.components, (k + 1) * curve.components);
}

function spliced<A extends Float64Array | Uint8Array>(array: A, at: number, replaced: number, put: ArrayLike<number>): A {
  const out = new (array.constructor as new (n: number) => A)(array.length - replaced + put.length);
  out.set(array.subarray(0, at));
  out.set(put, at);
  out.set(array.subarray(at + replaced), at + put.length);
  return out;
}

/** A curve of one key. Rotations go along the shortest arc with velocities from their neighbours; all else is Bezier. */
function firstKey(channel: ChannelId, time: number, value: readonly number[]): EditCurve {
  const kind = kindOf(channel), components = value.length;
  const rotation = kind === "rotation";
  return {
    channel,
    kind,
    components,
    times: Float64Array.of(time),
    values: Float64Array.from(value),
    modes: Uint8Array.of(rotation ? Mode.Squad : Mode.Bezier),
    inTangents: null,
    outTangents: null,
    inHandles: rotation ? null : new Float64Array(2 * components),
    outHandles: rotation ? null : new Float64Array(2 * components),
    types: rotation ? null : Uint8Array.of(Tangent.Clamped, Tangent.Clamped),
    before: "hold",
    after: "hold",
  };
}

/** A curve with a key of this value at a time, in place of one that is there already. Handles are not brought up to date. */
export function withKey(curve: EditCurve | undefined, channel: ChannelId, time: number, value: readonly number[]): EditCurve {
  if (!curve) return firstKey(channel, time, value);
  const C = curve.components;
  const there = keyAt(curve, time);
  if (there >= 0) return { ...curve, values: spliced(curve.values, there * C, C, value) };
  const k = curve.times.findIndex((t) => t > time);
  const at = k < 0 ? curve.times.length : k;
  const near = Math.max(0, at - 1);
  // the new span goes on as the one it splits
  const copy = <A extends Float64Array | Uint8Array>(array: A | null, width: number) =>
    array && spliced(array, at * width, 0, array.subarray(near * width, (near + 1) * width));
  const handles = (array: Float64Array | null) => array && spliced(array, at * C * 2, 0, new Float64Array(2 * C));
  const tangents = (array: Float64Array | null) => array && spliced(array, at * C, 0, new Float64Array(C));
  return {
    ...curve,
    times: spliced(curve.times, at, 0, [time]),
    values: spliced(curve.values, at * C, 0, value),
    modes: copy(curve.modes, 1)!,
    inTangents: tangents(curve.inTangents),
    outTangents: tangents(curve.outTangents),
    inHandles: handles(curve.inHandles),
    outHandles: handles(curve.outHandles),
    types: curve.types && spliced(curve.types, at * 2, 0, [Tangent.Clamped, Tangent.Clamped]),
  };
}
