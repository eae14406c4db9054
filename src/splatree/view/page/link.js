// The connection to the server: texts of JSON go out, binary messages come in (messages.py describes them).
const RETRY_MS = 1500;
const REFUSED = 1008, IDLE = 4000; // codes of closing (connection.py)

export class Link {
  /** `handlers` has a function for each kind of message: handler(header, payload as ArrayBuffer and offset). */
  constructor(scene, capacity, handlers) {
    const page = new URL(location.href), url = new URL('ws', page);
    url.protocol = page.protocol === 'https:' ? 'wss:' : 'ws:';
    url.search = new URLSearchParams({ scene, capacity, token: page.searchParams.get('token') ?? '' });
    url.hash = '';
    this.url = url;
    this.handlers = handlers;
    this.bytes = 0;
    this.seq = 0;
    this.open();
  }

  open() {
    const socket = new WebSocket(this.url);
    socket.binaryType = 'arraybuffer';
    this.taken = 0; // cuts and frames that came in
    this.acked = 0;
    socket.onopen = () => this.handlers.open?.();
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = (event) => {
      this.socket = null;
      this.handlers.closed?.(event.reason);
      if (event.code === IDLE) for (const name of ['pointerdown', 'keydown', 'wheel']) addEventListener(name, () => this.wake(), { once: true });
      else if (event.code !== REFUSED) setTimeout(() => this.reopen(), RETRY_MS);
    };
    this.socket = socket;
  }

  /** A hand is back: connect, if that has not been done. */
  wake() {
    if (!this.socket) this.open();
  }

  reopen() {
    if (document.visibilityState === 'visible') this.open();
    else document.addEventListener('visibilitychange', () => this.reopen(), { once: true });
  }

  receive(data) {
    this.bytes += data.byteLength;
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    header.bytes = data.byteLength;
    if (header.kind === 'cut' || header.kind === 'frame') this.taken++;
    this.handlers[header.kind]?.(header, data, 4 + length);
  }

  /** Say that everything that came in has been taken in. */
  ack() {
    if (this.acked === this.taken) return;
    this.acked = this.taken;
    this.send({ ack: this.taken });
  }

  /** Ask for something; returns its number, or 0 while there is no connection. */
  want(request) {
    if (!this.isOpen) return 0;
    this.send({ ...request, seq: ++this.seq });
    return this.seq;
  }

  send(record) {
    if (this.isOpen) this.socket.send(JSON.stringify(record));
  }

  get isOpen() {
    return this.socket?.readyState === WebSocket.OPEN;
  }
}
