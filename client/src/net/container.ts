// The binary container of every message and scene: see src/keypose/studio/container.py.

import type { ArrayRef } from "../generated/messages";

const MAGIC = 0x3153504b; // "KPS1", little-endian
const decoder = new TextDecoder();
const encoder = new TextEncoder();

export interface Container<H> {
  header: H;
  buffer: ArrayBuffer;
  body: number;
}

export function unpack<H>(buffer: ArrayBuffer): Container<H> {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0, true) !== MAGIC) throw new Error("not a keypose container");
  const length = view.getUint32(4, true);
  const header = JSON.parse(decoder.decode(new Uint8Array(buffer, 8, length))) as H;
  return { header, buffer, body: 8 + length };
}

/** A named run of bytes to be put into a container. */
export interface Blobs {
  name: string;
  data: ArrayBuffer;
}

type Packed = Float64Array | Float32Array | Uint8Array | Uint32Array;

const ELEMENTS = new Map<unknown, ArrayRef["element"]>([
  [Float64Array, "float64"],
  [Float32Array, "float32"],
  [Uint8Array, "uint8"],
  [Uint32Array, "uint32"],
]);

/** Collects the arrays of a container; each begins at a multiple of 8. */
export class Packer {
  private readonly chunks: Packed[] = [];
  private offset = 0;

  add(array: Packed, shape: number[] = [array.length]): ArrayRef {
    const ref: ArrayRef = { offset: this.offset, bytes: array.byteLength, element: ELEMENTS.get(array.constructor)!, shape };
    const padding = (8 - (array.byteLength % 8)) % 8;
    this.chunks.push(array, new Uint8Array(padding));
    this.offset += array.byteLength + padding;
    return ref;
  }

  /** The container with this header, for whatever size. */
  pack(header: object): Blob {
    return new Blob([this.head(header), ...(this.chunks as BlobPart[])]);
  }

  /** The same in one piece: for small ones that are sent many times a second, where making a blob takes longer than the rest. */
  bytes(header: object): Uint8Array<ArrayBuffer> {
    const head = this.head(header), out = new Uint8Array(head.length + this.offset);
    out.set(head);
    let at = head.length;
    for (const { buffer, byteOffset, byteLength } of this.chunks) {
      out.set(new Uint8Array(buffer, byteOffset, byteLength), at);
      at += byteLength;
    }
    return out;
  }

  private head(header: object): Uint8Array<ArrayBuffer> {
    const text = encoder.encode(JSON.stringify(header));
    const length = Math.ceil(text.length / 8) * 8;
    const head = new Uint8Array(8 + length).fill(0x20);
    new DataView(head.buffer).setUint32(0, MAGIC, true);
    new DataView(head.buffer).setUint32(4, length, true);
    head.set(text, 8);
    return head;
  }
}

/** An upload: files one after the other. */
export function packUpload(files: Blobs[]): Blob {
  const packer = new Packer();
  const entries = files.map(({ name, data }) => ({ name, bytes: packer.add(new Uint8Array(data)) }));
  return packer.pack({ type: "upload", files: entries });
}

/** Typed views into a container; nothing is copied. */
export class Arrays {
  constructor(private readonly container: Container<unknown>) {}

  private place(ref: ArrayRef, element: ArrayRef["element"]): [ArrayBuffer, number, number] {
    if (ref.element !== element) throw new Error(`expected ${element}, got ${ref.element}`);
    const size = ref.shape.reduce((n, m) => n * m, 1);
    return [this.container.buffer, this.container.body + ref.offset, size];
  }

  float32 = (ref: ArrayRef): Float32Array<ArrayBuffer> => new Float32Array(...this.place(ref, "float32"));
  float64 = (ref: ArrayRef): Float64Array<ArrayBuffer> => new Float64Array(...this.place(ref, "float64"));
  uint8 = (ref: ArrayRef): Uint8Array<ArrayBuffer> => new Uint8Array(...this.place(ref, "uint8"));
  uint16 = (ref: ArrayRef): Uint16Array<ArrayBuffer> => new Uint16Array(...this.place(ref, "uint16"));
  uint32 = (ref: ArrayRef): Uint32Array<ArrayBuffer> => new Uint32Array(...this.place(ref, "uint32"));
  int32 = (ref: ArrayRef): Int32Array<ArrayBuffer> => new Int32Array(...this.place(ref, "int32"));
  floats = (ref: ArrayRef): Float32Array<ArrayBuffer> | Float64Array<ArrayBuffer> =>
    ref.element === "float64" ? this.float64(ref) : this.float32(ref);
}
