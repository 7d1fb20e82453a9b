// Selected keys. The dope sheet selects whole keys; the graph selects components of them, which is remembered beside the
// indices: a list of indices that nothing is remembered of stands for whole keys.

import type { EditCurve, KeySelection } from "../contract";

const masks = new WeakMap<Uint32Array, Uint8Array>();
export const WHOLE = 255;

/** Bits of the selected components of each index; null for whole keys. */
export function masksOf(indices: Uint32Array): Uint8Array | null {
  return masks.get(indices) ?? null;
}

/** Indices with the components that are selected of each, told to `masksOf`. */
export function withMasks(indices: Uint32Array, of: Uint8Array | null): Uint32Array {
  if (of) masks.set(indices, of);
  return indices;
}

export function countKeys(selection: KeySelection): number {
  let count = 0;
  for (const indices of selection.values()) count += indices.length;
  return count;
}

export function isSelected(selection: KeySelection, channel: string, key: number, component = -1): boolean {
  const indices = selection.get(channel);
  if (!indices) return false;
  const at = find(indices, key);
  if (at < 0) return false;
  const mask = masksOf(indices);
  return component < 0 || !mask || ((mask[at] >> component) & 1) === 1;
}

export function find(indices: Uint32Array, key: number): number {
  let low = 0, high = indices.length - 1;
  while (low <= high) {
    const middle = (low + high) >> 1;
    if (indices[middle] === key) return middle;
    if (indices[middle] < key) low = middle + 1;
    else high = middle - 1;
  }
  return -1;
}

/** Keys with the components that are meant: what a click or a box hits. */
export type Hits = Map<string, Map<number, number>>;

export function hit(hits: Hits, channel: string, key: number, mask: number): void {
  let own = hits.get(channel);
  if (!own) hits.set(channel, (own = new Map()));
  own.set(key, (own.get(key) ?? 0) | mask);
}

export type How = "set" | "add" | "remove" | "toggle";

/** A selection after hits were set, added, removed or toggled. */
export function combined(selection: KeySelection, hits: Hits, how: How): KeySelection {
  if (how === "set") return fromHits(hits);
  const next: Hits = new Map();
  for (const [channel, indices] of selection) {
    const mask = masksOf(indices), own = new Map<number, number>();
    indices.forEach((k, n) => own.set(k, mask ? mask[n] : WHOLE));
    next.set(channel, own);
  }
  for (const [channel, own] of hits) {
    const kept = next.get(channel) ?? new Map<number, number>();
    for (const [k, mask] of own) {
      const old = kept.get(k) ?? 0;
      const now = how === "add" ? old | mask : how === "remove" ? old & ~mask : (old & mask) === mask ? old & ~mask : old | mask;
      if ((now & WHOLE) !== 0) kept.set(k, now & WHOLE);
      else kept.delete(k);
    }
    next.set(channel, kept);
  }
  return fromHits(next);
}

function fromHits(hits: Hits): KeySelection {
  const out = new Map<string, Uint32Array>();
  for (const [channel, own] of hits) {
    if (own.size === 0) continue;
    const indices = Uint32Array.from(own.keys()).sort();
    const mask = Uint8Array.from(indices, (k) => own.get(k)!);
    out.set(channel, withMasks(indices, mask.every((m) => m === WHOLE) ? null : mask));
  }
  return out;
}

/** Every key of these curves. */
export function everything(curves: Iterable<EditCurve>): KeySelection {
  const out = new Map<string, Uint32Array>();
  for (const { channel, times } of curves) out.set(channel.key, Uint32Array.from({ length: times.length }, (_, k) => k));
  return out;
}
