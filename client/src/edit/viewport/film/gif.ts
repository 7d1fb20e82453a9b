// GIF89a with one palette for the whole film. Source: CompuServe, Graphics Interchange Format 89a; Heckbert, Color image
// quantization for frame buffer display (SIGGRAPH 1982) for the median cut.

import { Bytes } from "./bytes";

const COLORS = 256;

/** The palette of some pictures (RGBA), 768 numbers. */
export function palette(samples: readonly Uint8ClampedArray[]): Uint8Array {
  const counts = new Map<number, number>();
  for (const pixels of samples)
    for (let i = 0; i < pixels.length; i += 4) {
      const color = ((pixels[i] >> 2) << 12) | ((pixels[i + 1] >> 2) << 6) | (pixels[i + 2] >> 2);
      counts.set(color, (counts.get(color) ?? 0) + 1);
    }
  const channel = (color: number, c: number) => (color >> (12 - 6 * c)) & 63;
  interface Box {
    colors: number[];
    axis: number;
    score: number;
  }
  const measured = (colors: number[]): Box => {
    let axis = 0, widest = -1, total = 0;
    for (const color of colors) total += counts.get(color)!;
    for (let c = 0; c < 3; c++) {
      let low = 64, high = -1;
      for (const color of colors) {
        const v = channel(color, c);
        low = Math.min(low, v);
        high = Math.max(high, v);
      }
      if (high - low > widest) [axis, widest] = [c, high - low];
    }
    return { colors, axis, score: colors.length < 2 ? 0 : widest * Math.sqrt(total) };
  };
  const boxes = [measured([...counts.keys()])];
  while (boxes.length < COLORS) {
    const worst = boxes.reduce((a, b) => (b.score > a.score ? b : a));
    if (worst.score === 0) break;
    const { colors, axis } = worst;
    colors.sort((a, b) => channel(a, axis) - channel(b, axis));
    let half = colors.reduce((sum, color) => sum + counts.get(color)!, 0) / 2, cut = 0;
    while (cut < colors.length - 1 && half > 0) half -= counts.get(colors[cut++])!;
    boxes.splice(boxes.indexOf(worst), 1, measured(colors.slice(0, Math.max(1, cut))), measured(colors.slice(Math.max(1, cut))));
  }
  const out = new Uint8Array(3 * COLORS);
  boxes.forEach(({ colors }, n) => {
    const sum = [0, 0, 0];
    let weight = 0;
    for (const color of colors) {
      const count = counts.get(color)!;
      weight += count;
      for (let c = 0; c < 3; c++) sum[c] += count * (channel(color, c) * 4 + 2);
    }
    for (let c = 0; c < 3; c++) out[3 * n + c] = weight > 0 ? Math.round(sum[c] / weight) : 0;
  });
  return out;
}

// ordered dithering: its pattern stands still from frame to frame
const BAYER = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5].map((v) => (v / 16 - 0.47) * 9);

export class Gif {
  private readonly out = new Bytes();
  private readonly nearest = new Int16Array(1 << 15).fill(-1);
  private shown = 0;
  private delayed = 0;

  constructor(
    private readonly width: number,
    private readonly height: number,
    private readonly rate: number,
    private readonly colors: Uint8Array,
  ) {
    this.out.text("GIF89a").le16(width).le16(height).put([0xf7, 0, 0]).put(colors);
    // again and again
    this.out.put([0x21, 0xff, 11]).text("NETSCAPE2.0").put([3, 1, 0, 0, 0]);
  }

  add(pixels: Uint8ClampedArray): void {
    // hundredths of a second, so that rounding does not add up
    this.shown++;
    const until = Math.round((100 * this.shown) / this.rate), delay = Math.max(2, until - this.delayed);
    this.delayed += delay;
    this.out.put([0x21, 0xf9, 4, 0x04]).le16(delay).put([0, 0]);
    this.out.put([0x2c]).le16(0).le16(0).le16(this.width).le16(this.height).put([0]);
    this.out.put(compressed(this.indices(pixels)));
  }

  private indices(pixels: Uint8ClampedArray): Uint8Array {
    const { width, nearest } = this;
    const out = new Uint8Array(pixels.length / 4);
    for (let n = 0, i = 0; n < out.length; n++, i += 4) {
      const d = BAYER[((Math.floor(n / width) & 3) << 2) | (n % width & 3)];
      const r = clamp(pixels[i] + d), g = clamp(pixels[i + 1] + d), b = clamp(pixels[i + 2] + d);
      const at = ((r >> 3) << 10) | ((g >> 3) << 5) | (b >> 3);
      let color = nearest[at];
      if (color < 0) color = nearest[at] = this.find(r, g, b);
      out[n] = color;
    }
    return out;
  }

  private find(r: number, g: number, b: number): number {
    const { colors } = this;
    let best = 0, least = Infinity;
    for (let n = 0; n < COLORS; n++) {
      const dr = colors[3 * n] - r, dg = colors[3 * n + 1] - g, db = colors[3 * n + 2] - b;
      const distance = 2 * dr * dr + 4 * dg * dg + 3 * db * db;
      if (distance < least) [best, least] = [n, distance];
    }
    return best;
  }

  finish(): Blob {
    return this.out.put([0x3b]).blob("image/gif");
  }
}

const clamp = (v: number) => (v < 0 ? 0 : v > 255 ? 255 : Math.round(v));

/** LZW with codes of 9 to 12 bits, in blocks of at most 255 bytes. */
function compressed(indices: Uint8Array): Uint8Array {
  const CLEAR = 256, END = 257;
  let out = new Uint8Array(1024), size = 0;
  let bits = 0, held = 0, width = 9, next = 258;
  // code of a string and the colour after it -> code of both; stamped, so that clearing costs nothing
  const table = new Int32Array(4096 * 256), stamps = new Uint16Array(4096 * 256);
  let stamp = 1, block = -1;
  const byte = (value: number) => {
    if (size + 2 > out.length) {
      const grown = new Uint8Array(2 * out.length);
      grown.set(out);
      out = grown;
    }
    if (block < 0 || out[block] === 255) {
      block = size++;
      out[block] = 0;
    }
    out[size++] = value;
    out[block]++;
  };
  const emit = (code: number) => {
    held |= code << bits;
    bits += width;
    while (bits >= 8) {
      byte(held & 255);
      held >>>= 8;
      bits -= 8;
    }
  };
  out[size++] = 8;
  emit(CLEAR);
  let prefix = indices[0];
  for (let n = 1; n < indices.length; n++) {
    const key = (prefix << 8) | indices[n];
    if (stamps[key] === stamp) {
      prefix = table[key];
      continue;
    }
    emit(prefix);
    if (next < 4096) {
      table[key] = next;
      stamps[key] = stamp;
      if (next === 1 << width && width < 12) width++;
      next++;
    } else {
      emit(CLEAR);
      stamp++;
      next = 258;
      width = 9;
    }
    prefix = indices[n];
  }
  emit(prefix);
  emit(END);
  if (bits > 0) byte(held & 255);
  const done = new Uint8Array(size + 1);
  done.set(out.subarray(0, size));
  return done;
}
