// A ZIP of files as they are. Source: PKWARE, APPNOTE.TXT 6.3.

import { Bytes } from "./bytes";

const TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  let c = n;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c;
});

function crc32(data: Uint8Array): number {
  let crc = 0xffffffff;
  for (let n = 0; n < data.length; n++) crc = TABLE[(crc ^ data[n]) & 255] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

export function zip(files: readonly { name: string; data: Uint8Array }[]): Blob {
  const out = new Bytes(), index = new Bytes();
  // 1 January 1980, the first day that the format knows
  const day = 33;
  for (const { name, data } of files) {
    const letters = new TextEncoder().encode(name), crc = crc32(data), at = out.length;
    const facts = (b: Bytes) => b.le16(20).le16(0x800).le16(0).le16(0).le16(day).le32(crc).le32(data.length).le32(data.length).le16(letters.length).le16(0);
    facts(out.le32(0x04034b50)).put(letters).put(data);
    facts(index.le32(0x02014b50).le16(20)).le16(0).le16(0).le16(0).le32(0).le32(at).put(letters);
  }
  const at = out.length;
  return out.add(index).le32(0x06054b50).le16(0).le16(0).le16(files.length).le16(files.length).le32(index.length).le32(at).le16(0).blob("application/zip");
}
