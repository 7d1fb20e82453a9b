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

/** An upload: files one after the other, each at a multiple of 8. */
export function packUpload(files: Blobs[]): Blob {
  let offset = 0;
  const chunks: BlobPart[] = [];
  const entries = files.map(({ name, data }) => {
    const bytes: ArrayRef = { offset, bytes: data.byteLength, element: "uint8", shape: [data.byteLength] };
    const padding = (8 - (data.byteLength % 8)) % 8;
    chunks.push(data, new Uint8Array(padding));
    offset += data.byteLength + padding;
    return { name, bytes };
  });
  const text = encoder.encode(JSON.stringify({ type: "upload", files: entries }));
  const length = Math.ceil(text.length / 8) * 8;
  const head = new Uint8Array(8 + length).fill(0x20);
  new DataView(head.buffer).setUint32(0, MAGIC, true);
  new DataView(head.buffer).setUint32(4, length, true);
  head.set(text, 8);
  return new Blob([head, ...chunks]);
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
