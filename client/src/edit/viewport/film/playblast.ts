// A film of the view over a range, picture by picture: what comes out does not depend on how fast the machine is.

import { studio } from "../../../studio.svelte";
import { timecode } from "../../../anim/clock";
import type { Viewport } from "../../../view/viewport";
import type { Chunk } from "./bytes";
import { Gif, palette } from "./gif";
import { mp4 } from "./mp4";
import { webm } from "./webm";
import { zip } from "./zip";

export type Format = "mp4" | "webm" | "gif" | "png";
export type Burn = "none" | "frames" | "timecode";

export interface FilmSettings {
  readonly format: Format;
  readonly width: number;
  readonly height: number;
  readonly rate: number;
  /** Seconds; the last frame is the one at or before `end`. */
  readonly start: number;
  readonly end: number;
  readonly burn: Burn;
  /** What is written beside the number. */
  readonly title: string;
  /** Bones, paths and ghosts as they are shown. */
  readonly overlays: boolean;
}

export interface Progress {
  readonly done: number;
  readonly total: number;
}

export const SUFFIXES: Record<Format, string> = { mp4: "mp4", webm: "webm", gif: "gif", png: "zip" };

// the best first; the number after it is H.264's profile and level
const CODECS = { mp4: ["avc1.640033", "avc1.64002a", "avc1.640028", "avc1.4d0028", "avc1.42002a", "avc1.42001f"], webm: ["vp09.00.51.08", "vp09.00.41.08", "vp09.00.10.08", "vp8"] } as const;

function configuration(codec: string, { width, height, rate }: Pick<FilmSettings, "width" | "height" | "rate">): VideoEncoderConfig {
  // about 0.15 bits for each pixel: cartoons on a plain ground need no more
  const bitrate = Math.round(Math.max(1e6, 0.15 * width * height * rate));
  return { codec, width, height, framerate: rate, bitrate, latencyMode: "quality", ...(codec.startsWith("avc1") ? { avc: { format: "avc" as const } } : {}) };
}

/** The codec that this browser encodes a format with, or null. Pictures as files and GIF need none. */
export async function codecFor(format: Format, size: Pick<FilmSettings, "width" | "height" | "rate">): Promise<string | null> {
  if (format === "gif" || format === "png") return format;
  if (typeof VideoEncoder === "undefined") return null;
  for (const codec of CODECS[format]) {
    try {
      if ((await VideoEncoder.isConfigSupported(configuration(codec, size))).supported) return codec;
    } catch {
      // a browser that does not know the codec's name
    }
  }
  return null;
}

/** Times of the pictures, in seconds. */
export function frameTimes({ start, end, rate }: Pick<FilmSettings, "start" | "end" | "rate">): number[] {
  const count = Math.max(1, Math.floor((end - start) * rate + 1e-6) + 1);
  return Array.from({ length: count }, (_, n) => start + n / rate);
}

interface Sink {
  add(canvas: HTMLCanvasElement, frame: number): Promise<void>;
  finish(): Promise<Blob>;
  close(): void;
}

class VideoSink implements Sink {
  private readonly chunks: Chunk[] = [];
  private description: Uint8Array | null = null;
  private failure: Error | null = null;
  private readonly encoder: VideoEncoder;

  constructor(
    private readonly settings: FilmSettings,
    private readonly codec: string,
  ) {
    this.encoder = new VideoEncoder({
      output: (chunk, metadata) => {
        const data = new Uint8Array(chunk.byteLength);
        chunk.copyTo(data);
        const given = metadata?.decoderConfig?.description;
        if (given) this.description = ArrayBuffer.isView(given) ? new Uint8Array(given.buffer.slice(given.byteOffset, given.byteOffset + given.byteLength) as ArrayBuffer) : new Uint8Array(given.slice(0) as ArrayBuffer);
        this.chunks.push({ data, key: chunk.type === "key", frame: Math.round((chunk.timestamp * settings.rate) / 1e6) });
      },
      error: (error) => (this.failure = error),
    });
    this.encoder.configure(configuration(codec, settings));
  }

  async add(canvas: HTMLCanvasElement, frame: number): Promise<void> {
    const { rate } = this.settings;
    const picture = new VideoFrame(canvas, { timestamp: Math.round((1e6 * frame) / rate), duration: Math.round(1e6 / rate) });
    // a place to jump to every two seconds
    this.encoder.encode(picture, { keyFrame: frame % Math.max(1, Math.round(2 * rate)) === 0 });
    picture.close();
    while (this.encoder.encodeQueueSize > 3 && !this.failure) await pause();
    if (this.failure) throw this.failure;
  }

  async finish(): Promise<Blob> {
    await this.encoder.flush();
    if (this.failure) throw this.failure;
    if (this.settings.format === "webm") return webm(this.chunks, this.settings, this.codec === "vp8" ? "V_VP8" : "V_VP9");
    if (!this.description) throw new Error("the browser's encoder did not describe its film");
    return mp4(this.chunks, this.settings, this.description);
  }

  close(): void {
    if (this.encoder.state !== "closed") this.encoder.close();
  }
}

class GifSink implements Sink {
  private gif: Gif | null = null;

  constructor(
    private readonly settings: FilmSettings,
    private readonly samples: readonly Uint8ClampedArray[],
  ) {}

  async add(canvas: HTMLCanvasElement): Promise<void> {
    const { width, height, rate } = this.settings;
    this.gif ??= new Gif(width, height, rate, palette(this.samples));
    this.gif.add(pixelsOf(canvas));
  }

  async finish(): Promise<Blob> {
    return this.gif!.finish();
  }

  close(): void {}
}

class PictureSink implements Sink {
  private readonly files: { name: string; data: Uint8Array }[] = [];

  constructor(private readonly first: number) {}

  async add(canvas: HTMLCanvasElement, frame: number): Promise<void> {
    const blob = await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve, "image/png"));
    if (!blob) throw new Error("the browser made no picture");
    this.files.push({ name: `frame-${String(this.first + frame).padStart(4, "0")}.png`, data: new Uint8Array(await blob.arrayBuffer()) });
  }

  async finish(): Promise<Blob> {
    return zip(this.files);
  }

  close(): void {}
}

const pixelsOf = (canvas: HTMLCanvasElement) => canvas.getContext("2d")!.getImageData(0, 0, canvas.width, canvas.height).data;

/** Let the page live for a moment. */
const pause = () => new Promise<void>((resolve) => setTimeout(resolve));

/**
 * Make a film. Pictures are drawn into `canvas`, where one can watch them; null where it was cancelled.
 * The time and the window are afterwards as they were.
 */
export async function playblast(view: Viewport, settings: FilmSettings, canvas: HTMLCanvasElement, told: (progress: Progress) => void, signal: AbortSignal): Promise<Blob | null> {
  const codec = await codecFor(settings.format, settings);
  if (codec === null) throw new Error(`this browser cannot encode ${settings.format.toUpperCase()} of ${settings.width} x ${settings.height}`);
  const times = frameTimes(settings), { clock } = view, kept = clock.time;
  canvas.width = settings.width;
  canvas.height = settings.height;
  const context = canvas.getContext("2d", { willReadFrequently: settings.format === "gif" })!;
  const film = view.film(settings.width, settings.height, !settings.overlays);
  let sink: Sink | null = null;
  const draw = (n: number) => {
    clock.time = studio.time = times[n];
    context.drawImage(film.draw(), 0, 0);
    if (settings.burn !== "none") burnIn(context, settings, times[n]);
  };
  try {
    const samples: Uint8ClampedArray[] = [];
    if (settings.format === "gif")
      for (let n = 0; n < 6; n++) {
        draw(Math.round((n / 5) * (times.length - 1)));
        samples.push(pixelsOf(canvas));
      }
    sink =
      settings.format === "gif" ? new GifSink(settings, samples)
      : settings.format === "png" ? new PictureSink(Math.round(settings.start * settings.rate))
      : new VideoSink(settings, codec);
    for (let n = 0; n < times.length; n++) {
      if (signal.aborted) return null;
      draw(n);
      await sink.add(canvas, n);
      told({ done: n + 1, total: times.length });
      await pause();
    }
    return signal.aborted ? null : await sink.finish();
  } finally {
    sink?.close();
    clock.time = studio.time = kept;
    film.end();
    view.invalidatePose();
  }
}

/** The title, and the number of the frame or its time, on a dark plate below. */
function burnIn(context: CanvasRenderingContext2D, { width, height, rate, burn, title }: FilmSettings, time: number): void {
  const size = Math.max(11, Math.round(height / 32)), pad = Math.round(0.55 * size);
  const frame = Math.round(time * rate);
  const number = burn === "frames" ? `frame ${String(frame).padStart(4, "0")}  ·  ${rate} fps` : timecode(time, rate);
  context.save();
  context.font = `600 ${size}px ui-monospace, "DejaVu Sans Mono", monospace`;
  context.textBaseline = "middle";
  const y = height - 2 * pad - 0.5 * size;
  const plate = (text: string, x: number, align: "left" | "right") => {
    const wide = context.measureText(text).width + 2 * pad;
    const left = align === "left" ? x : x - wide;
    context.fillStyle = "rgb(10 11 13 / 62%)";
    context.beginPath();
    context.roundRect(left, y - 0.5 * size - 0.7 * pad, wide, size + 1.4 * pad, 0.6 * pad);
    context.fill();
    context.fillStyle = "#f2f3f5";
    context.fillText(text, left + pad, y + 0.04 * size);
  };
  if (title) plate(title, 1.2 * pad, "left");
  plate(number, width - 1.2 * pad, "right");
  context.restore();
}
