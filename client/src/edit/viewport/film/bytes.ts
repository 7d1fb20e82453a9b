// A growing array of bytes, big-endian as film files want it.

export class Bytes {
  private buffer = new Uint8Array(64);
  length = 0;

  put(bytes: ArrayLike<number>): this {
    const end = this.length + bytes.length;
    if (end > this.buffer.length) {
      const grown = new Uint8Array(Math.max(end, 2 * this.buffer.length));
      grown.set(this.buffer.subarray(0, this.length));
      this.buffer = grown;
    }
    this.buffer.set(bytes, this.length);
    this.length = end;
    return this;
  }

  text(text: string): this {
    return this.put(new TextEncoder().encode(text));
  }

  u8(value: number): this {
    return this.put([value & 255]);
  }

  u16(value: number): this {
    return this.put([(value >> 8) & 255, value & 255]);
  }

  u32(value: number): this {
    return this.put([(value >>> 24) & 255, (value >>> 16) & 255, (value >>> 8) & 255, value & 255]);
  }

  u64(value: number): this {
    return this.u32(Math.floor(value / 2 ** 32)).u32(value >>> 0);
  }

  f64(value: number): this {
    const bytes = new Uint8Array(8);
    new DataView(bytes.buffer).setFloat64(0, value);
    return this.put(bytes);
  }

  zeros(count: number): this {
    return this.put(new Uint8Array(count));
  }

  add(other: Bytes): this {
    return this.put(other.buffer.subarray(0, other.length));
  }

  /** Little-endian, as ZIP and GIF want it. */
  le16(value: number): this {
    return this.put([value & 255, (value >> 8) & 255]);
  }

  le32(value: number): this {
    return this.put([value & 255, (value >>> 8) & 255, (value >>> 16) & 255, (value >>> 24) & 255]);
  }

  blob(type: string): Blob {
    return new Blob([this.buffer.subarray(0, this.length)], { type });
  }
}

/** One encoded picture. */
export interface Chunk {
  readonly data: Uint8Array;
  readonly key: boolean;
  /** Its number in the film. */
  readonly frame: number;
}

export interface FilmSize {
  readonly width: number;
  readonly height: number;
  readonly rate: number;
}
