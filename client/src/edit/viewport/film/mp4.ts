// MP4: H.264 in an ISO base media file, its index in front. Source: ISO/IEC 14496-12 and 14496-15.

import { Bytes, type Chunk, type FilmSize } from "./bytes";

const box = (type: string, ...parts: Bytes[]): Bytes => {
  const body = parts.reduce((all, part) => all.add(part), new Bytes());
  return new Bytes().u32(8 + body.length).text(type).add(body);
};
const full = (type: string, version: number, flags: number, ...parts: Bytes[]): Bytes =>
  box(type, new Bytes().u32(version * 2 ** 24 + flags), ...parts);
const bytes = () => new Bytes();
const MATRIX = [0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000];
const matrix = () => MATRIX.reduce((out, value) => out.u32(value), bytes());

/** `description` is the decoder's configuration (avcC) as the encoder gave it. */
export function mp4(chunks: readonly Chunk[], { width, height, rate }: FilmSize, description: Uint8Array): Blob {
  // a clock in which a frame of any usual rate is a whole number: 23.976 is 24000 / 1001
  const step = Number.isInteger(rate) ? 1000 : 1001;
  const scale = Math.round(rate * step);
  const duration = step * chunks.length;
  const total = chunks.reduce((sum, { data }) => sum + data.length, 0);
  const keys = chunks.flatMap(({ key }, n) => (key ? [n + 1] : []));
  const moved = chunks.some(({ frame }, n) => frame !== n);

  const tables = (offset: number): Bytes[] => [
    full("stsd", 0, 0, bytes().u32(1), box("avc1",
      bytes().zeros(6).u16(1).zeros(16).u16(width).u16(height).u32(0x480000).u32(0x480000).u32(0).u16(1).zeros(32).u16(24).u16(0xffff),
      box("avcC", bytes().put(description)),
      // BT.709, as the pictures were made
      box("colr", bytes().text("nclx").u16(1).u16(1).u16(1).u8(0)))),
    full("stts", 0, 0, bytes().u32(1).u32(chunks.length).u32(step)),
    ...(moved ? [full("ctts", 1, 0, chunks.reduce((out, { frame }, n) => out.u32(1).u32((frame - n) * step), bytes().u32(chunks.length)))] : []),
    full("stss", 0, 0, keys.reduce((out, n) => out.u32(n), bytes().u32(keys.length))),
    full("stsc", 0, 0, bytes().u32(1).u32(1).u32(chunks.length).u32(1)),
    full("stsz", 0, 0, chunks.reduce((out, { data }) => out.u32(data.length), bytes().u32(0).u32(chunks.length))),
    full("stco", 0, 0, bytes().u32(1).u32(offset)),
  ];
  const moov = (offset: number): Bytes => box("moov",
    full("mvhd", 0, 0, bytes().u32(0).u32(0).u32(scale).u32(duration).u32(0x10000).u16(0x100).zeros(10), matrix(), bytes().zeros(24).u32(2)),
    box("trak",
      full("tkhd", 0, 3, bytes().u32(0).u32(0).u32(1).u32(0).u32(duration).zeros(8).u16(0).u16(0).u16(0).u16(0), matrix(), bytes().u32(width * 65536).u32(height * 65536)),
      box("mdia",
        full("mdhd", 0, 0, bytes().u32(0).u32(0).u32(scale).u32(duration).u16(0x55c4).u16(0)),
        full("hdlr", 0, 0, bytes().u32(0).text("vide").zeros(12).text("keypose").u8(0)),
        box("minf",
          full("vmhd", 0, 1, bytes().zeros(8)),
          box("dinf", full("dref", 0, 0, bytes().u32(1), full("url ", 0, 1))),
          box("stbl", ...tables(offset))))));

  const head = box("ftyp", bytes().text("isom").u32(0x200).text("isom").text("iso2").text("avc1").text("mp41"));
  const index = moov(0);
  const offset = head.length + index.length + 8;
  const out = head.add(moov(offset)).u32(8 + total).text("mdat");
  for (const { data } of chunks) out.put(data);
  return out.blob("video/mp4");
}
