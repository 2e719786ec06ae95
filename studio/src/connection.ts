// The WebSocket: greets, decodes, keeps messages in their order, and connects again when it is cut.

import type { Arrays } from "./arrays.ts";
import { decode, encode } from "./framing.ts";
import type { ClientMessage, ServerMessage } from "./protocol.ts";

export type Link = "connecting" | "open" | "waiting" | "refused";

const WRONG_TOKEN = 4401;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;

export class Connection {
  #socket: WebSocket | null = null;
  #wait_ms = FIRST_WAIT_MS;

  /** on.link: a change of the connection. on.message: one message after the other, as the server sent them. on.broken: a frame that could not be read. */
  constructor(
    private readonly url: string,
    private readonly token: string,
    private readonly on: {
      link: (link: Link) => void;
      message: (message: ServerMessage, arrays: Arrays) => void;
      broken: (sentence: string) => void;
    },
  ) {
    if (token === "") on.link("refused");
    else this.#connect();
  }

  /** Send a message; without a connection it is dropped, as all comes anew after the next `welcome`. */
  send(message: ClientMessage, arrays?: Arrays): void {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(encode(message, arrays));
  }

  #connect(): void {
    this.on.link("connecting");
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    let last = Promise.resolve();
    socket.onopen = () => this.send({ type: "hello", token: this.token, name: "studio page" });
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      const decoding = decode(event.data);
      last = last
        .then(() => decoding)
        .then(([message, arrays]) => {
          if (socket !== this.#socket) return;
          if (message.type === "welcome") {
            this.#wait_ms = FIRST_WAIT_MS;
            this.on.link("open");
          }
          this.on.message(message, arrays);
        })
        .catch((error: unknown) => {
          console.error(error);
          this.on.broken(`A message of the server could not be shown: ${error instanceof Error ? error.message : error}`);
        });
    };
    socket.onclose = ({ code }) => {
      if (socket !== this.#socket) return;
      this.#socket = null;
      if (code === WRONG_TOKEN) {
        this.on.link("refused");
        return;
      }
      this.on.link("waiting");
      setTimeout(() => this.#connect(), this.#wait_ms);
      this.#wait_ms = Math.min(2 * this.#wait_ms, LONGEST_WAIT_MS);
    };
  }
}
