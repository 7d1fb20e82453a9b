// The line to the server: events over a WebSocket, scenes and uploads over HTTP.

import type { ClientMessage, Envelope, ServerMessage, UploadResult } from "../generated/messages";
import { packUpload, unpack, type Blobs, type Container } from "./container";

export class Connection {
  /** The token from the URL; every request carries it. */
  private readonly token = new URLSearchParams(location.search).get("token") ?? "";
  private socket: WebSocket | null = null;
  private retry = 500;

  constructor(
    private readonly receive: (message: ServerMessage, container: Container<Envelope>) => void,
    private readonly online: (online: boolean) => void,
  ) {
    this.open();
  }

  private open(): void {
    const url = new URL(`api/events?token=${encodeURIComponent(this.token)}`, location.href);
    url.protocol = "ws:";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.retry = 500;
      this.online(true);
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      const container = unpack<Envelope>(event.data);
      const { header } = container;
      this.receive(header.message, container);
      this.send({ type: "acknowledge", sequence: header.sequence });
    };
    socket.onclose = () => {
      this.online(false);
      setTimeout(() => this.open(), this.retry);
      this.retry = Math.min(8000, this.retry * 2);
    };
  }

  send(message: ClientMessage): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  private get headers(): Record<string, string> {
    return { "X-Keypose-Token": this.token };
  }

  /** Fetch a scene, reporting how much of it has come. */
  async scene<H>(id: string, bytes: number, report: (fraction: number) => void): Promise<Container<H>> {
    const response = await fetch(`api/scenes/${encodeURIComponent(id)}`, { headers: this.headers });
    if (!response.ok || !response.body) throw new Error(`the server answered ${response.status}`);
    const data = new Uint8Array(bytes);
    const reader = response.body.getReader();
    let received = 0;
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (received + value.length > bytes) throw new Error("more data than announced");
      data.set(value, received);
      received += value.length;
      report(received / bytes);
    }
    if (received !== bytes) throw new Error("the connection broke off");
    return unpack<H>(data.buffer);
  }

  /** A recording as a file. */
  take(id: string, kind: "glb" | "bvh"): Promise<Blob> {
    return this.file(`api/takes/${encodeURIComponent(id)}/${kind}`);
  }

  /** A container of ours, answered in JSON; what the server refuses is in the answer. */
  async post<R>(path: string, body: Blob): Promise<R> {
    const response = await fetch(path, { method: "POST", headers: this.headers, body });
    if (response.headers.get("content-type")?.startsWith("application/json")) return (await response.json()) as R;
    throw new Error((await response.text()).trim() || `the server answered ${response.status}`);
  }

  /** A container of ours, answered by another. */
  async exchange(path: string, body: Uint8Array<ArrayBuffer>): Promise<ArrayBuffer> {
    const response = await fetch(path, { method: "POST", headers: this.headers, body });
    if (!response.ok) throw new Error((await response.text()).trim() || `the server answered ${response.status}`);
    return response.arrayBuffer();
  }

  async json<R>(path: string): Promise<R> {
    return JSON.parse(await (await this.file(path)).text()) as R;
  }

  /** Anything that the server writes as a file. */
  async file(path: string): Promise<Blob> {
    const response = await fetch(path, { headers: this.headers });
    if (!response.ok) throw new Error((await response.text()).trim() || `the server answered ${response.status}`);
    return response.blob();
  }

  async upload(files: Blobs[]): Promise<UploadResult> {
    const response = await fetch("api/scenes", { method: "POST", headers: this.headers, body: packUpload(files) });
    if (response.headers.get("content-type")?.startsWith("application/json")) return (await response.json()) as UploadResult;
    return { opened: [], errors: [`the server answered ${response.status}`], graphs: [] };
  }
}
