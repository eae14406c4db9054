// One scene in the page: its connection, its nodes, and the exact picture of the server.
import { Link } from './link.js';
import { ROW, Store } from './store.js';

const SEND_MS = 30; // between two views of a camera that moves

export class Layer {
  /** `painter` is null where pictures of the server are all that is shown. `on`: scene, cut, frame, point, boxes, notice. */
  constructor(index, capacity, painter, on) {
    this.painter = painter;
    this.on = on;
    this.facts = null;
    this.range = [1, 2];
    this.isSettled = false; // the last cut asked for is drawn
    this.isWaiting = false; // for a picture, where the server draws
    this.asked = { cut: 0, frame: 0 };
    this.sentAt = 0;
    this.fade = 0;
    if (painter) {
      this.room = painter.makeRoom(capacity);
      this.store = new Store(capacity, (order) => this.ordered(order));
    }
    this.link = new Link(index, capacity, {
      scene: (header) => this.begin(header),
      cut: (header, data, offset) => this.cut(header, data, offset),
      frame: (header, data, offset) => this.frame(header, data, offset),
      point: (header) => on.point(header.point),
      boxes: (header, data, offset) => on.boxes(header, new Float32Array(data, offset, 6 * header.count)),
      look: (header) => on.look(header),
      error: (header) => {
        this.isWaiting = false;
        on.notice(header.text);
      },
      open: () => on.notice(''),
      closed: (reason) => on.notice(reason.startsWith('idle') ? 'The connection rests. Click or press a key to go on.' : reason || 'The connection is lost; trying again …'),
    });
  }

  begin(header) {
    const isFirst = this.facts === null;
    this.facts = header;
    this.header = null;
    this.isSettled = this.isWaiting = false; // what was asked before is not answered any more
    this.store?.clear();
    this.link.ack(); // of what was just forgotten too
    this.drop();
    this.on.scene(this, isFirst);
  }

  /** Ask for the cut of a view; at once, or as soon as the last request is 30 ms old. */
  askCut(request, now) {
    if (!this.facts || now - this.sentAt < SEND_MS) return false;
    this.sentAt = now;
    this.isSettled = false;
    this.asked.cut = this.link.want({ ...request, want: 'cut' });
    return true;
  }

  askFrame(request, isExact) {
    this.isAskedExact = isExact;
    this.frameAskedAt = performance.now();
    this.asked.frame = this.link.want({ ...request, want: 'frame' });
  }

  cut(header, data, offset) {
    this.firstBytes ??= this.link.bytes; // of what the first picture needs
    this.store.take(header, data, offset);
    this.on.cut(this);
  }

  /** The worker's order of the nodes is back: what came in before it is drawn now. */
  ordered({ order, range, ms, applied, runs }) {
    this.painter.update(this.room, this.store.words, runs, order);
    this.range = range;
    this.sortMs = ms;
    if (applied.length) {
      this.header = applied.at(-1);
      this.isSettled = this.header.last && this.header.seq === this.asked.cut;
      this.link.ack();
    }
    this.on.drawn(this, applied);
  }

  async frame(header, data, offset) {
    if (header.seq !== this.asked.frame) {
      this.link.ack();
      return;
    }
    const bitmap = await createImageBitmap(new Blob([new Uint8Array(data, offset)], { type: header.type }));
    header.took = performance.now() - this.frameAskedAt;
    this.link.ack();
    if (header.seq !== this.asked.frame) return;
    this.frameHeader = header;
    this.bitmap = bitmap;
    this.isExact = this.isAskedExact;
    this.painter?.setPicture(this.room, bitmap);
    this.on.frame(this, header);
  }

  /** The graphics processor is back and has nothing: copy all nodes to it; their order follows. */
  restore() {
    this.room = this.painter.makeRoom(this.store.capacity);
    this.painter.update(this.room, this.store.words, [[0, Math.ceil(this.store.capacity / ROW)]], new Uint32Array(0));
  }

  /** The picture is of a camera that has moved on: forget it, or keep it until the next where the server draws. */
  drop(isKept = false) {
    if (!isKept) {
      this.asked.frame = -1;
      this.fade = 0;
      this.bitmap = null;
    }
    this.isExact = this.isAskedExact = false;
  }
}
