// The crowd's own line to the server: big frames, and nothing else waits behind them.

import type { CrowdMessage, CrowdRequest } from "../generated/messages";
import { unpack, type Container } from "../net/container";

export class CrowdConnection {
  private socket: WebSocket | null = null;
  private closed = false;
  private retry = 500;

  constructor(
    private readonly receive: (container: Container<CrowdMessage>, bytes: number) => void,
    private readonly online: (online: boolean) => void,
  ) {
    this.open();
  }

  private open(): void {
    const token = new URLSearchParams(location.search).get("token") ?? "";
    const url = new URL(`api/crowd?token=${encodeURIComponent(token)}`, location.href);
    url.protocol = "ws:";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.retry = 500;
      this.online(true);
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => this.receive(unpack<CrowdMessage>(event.data), event.data.byteLength);
    socket.onclose = () => {
      if (this.closed) return;
      this.online(false);
      setTimeout(() => !this.closed && this.open(), this.retry);
      this.retry = Math.min(8000, this.retry * 2);
    };
  }

  send(message: CrowdRequest): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  close(): void {
    this.closed = true;
    this.socket?.close();
  }
}
