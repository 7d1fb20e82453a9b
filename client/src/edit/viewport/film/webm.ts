// WebM: VP9 or VP8 in a Matroska container. Source: RFC 8794 (EBML), RFC 9559 (Matroska).

import { Bytes, type Chunk, type FilmSize } from "./bytes";

/** An element's size in eight bytes, so that sizes never change places. */
function sized(id: readonly number[], body: Bytes): Bytes {
  return new Bytes().put(id).put([0x01]).put(new Bytes56(body.length).bytes).add(body);
}

class Bytes56 {
  readonly bytes: number[] = [];
  constructor(value: number) {
    for (let n = 6; n >= 0; n--) this.bytes.push(Math.floor(value / 256 ** n) % 256);
  }
}

const number = (id: readonly number[], value: number): Bytes => sized(id, new Bytes().u64(value));
const text = (id: readonly number[], value: string): Bytes => sized(id, new Bytes().text(value));
const join = (...parts: Bytes[]): Bytes => parts.reduce((all, part) => all.add(part), new Bytes());

export function webm(chunks: readonly Chunk[], { width, height, rate }: FilmSize, codec: "V_VP9" | "V_VP8"): Blob {
  const head = sized([0x1a, 0x45, 0xdf, 0xa3], join(
    number([0x42, 0x86], 1), number([0x42, 0xf7], 1), number([0x42, 0xf2], 4), number([0x42, 0xf3], 8),
    text([0x42, 0x82], "webm"), number([0x42, 0x87], 4), number([0x42, 0x85], 2),
  ));
  const milliseconds = (frame: number) => Math.round((1000 * frame) / rate);
  const info = sized([0x15, 0x49, 0xa9, 0x66], join(
    number([0x2a, 0xd7, 0xb1], 1_000_000),
    sized([0x44, 0x89], new Bytes().f64((1000 * chunks.length) / rate)),
    text([0x4d, 0x80], "keypose"), text([0x57, 0x41], "keypose"),
  ));
  const video = sized([0xe0], join(number([0xb0], width), number([0xba], height)));
  const track = sized([0xae], join(
    number([0xd7], 1), number([0x73, 0xc5], 1), number([0x83], 1), number([0x9c], 0),
    number([0x23, 0xe3, 0x83], Math.round(1e9 / rate)), text([0x86], codec), video,
  ));
  const tracks = sized([0x16, 0x54, 0xae, 0x6b], track);
  // a cluster begins with a picture that needs no other
  const clusters: Bytes[] = [], starts: number[] = [];
  let body = new Bytes(), base = 0;
  const close = () => {
    if (body.length > 0) clusters.push(sized([0x1f, 0x43, 0xb6, 0x75], body));
  };
  for (const { data, key, frame } of chunks) {
    if (key || body.length === 0) {
      close();
      base = milliseconds(frame);
      starts.push(base);
      body = number([0xe7], base);
    }
    const offset = milliseconds(frame) - base;
    body.add(sized([0xa3], new Bytes().u8(0x81).u16(offset).u8(key ? 0x80 : 0).put(data)));
  }
  close();
  // where to jump to: the places of the clusters after the head of the segment
  const cue = (time: number, place: number) =>
    sized([0xbb], join(number([0xb3], time), sized([0xb7], join(number([0xf7], 1), number([0xf1], place)))));
  const cues = (places: number[]) => sized([0x1c, 0x53, 0xbb, 0x6b], join(...places.map((place, n) => cue(starts[n], place))));
  let place = info.length + tracks.length + cues(starts.map(() => 0)).length;
  const places = clusters.map((cluster) => {
    const here = place;
    place += cluster.length;
    return here;
  });
  const segment = sized([0x18, 0x53, 0x80, 0x67], join(info, tracks, cues(places), ...clusters));
  return head.add(segment).blob("video/webm");
}
