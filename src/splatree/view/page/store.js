// The nodes of one scene in the page: what came in and is not yet drawn, and the order in which they are drawn.
//
// A change is kept until the worker's order that knows of it is back; then texture and order change together, so every picture
// shows one exact cut.
const WORDS = 8; // of a node, as nodes.py packs it
export const ROW = 1024; // nodes in a row of the texture

export class Store {
  constructor(capacity, onOrder) {
    this.capacity = capacity;
    this.words = new Uint32Array(capacity * WORDS);
    this.floats = new Float32Array(this.words.buffer);
    this.version = 0; // of the last change that came in
    this.pending = [];
    this.isSorting = false;
    this.header = null; // of the last change that is drawn
    this.onOrder = onOrder;
    this.worker = new Worker(new URL('./sorter.js', import.meta.url), { type: 'module' });
    this.worker.onmessage = (event) => this.sorted(event.data);
    this.worker.postMessage({ change: { capacity } });
  }

  /** Forget all nodes, but go on drawing them until the first cut of what follows is there. */
  clear() {
    this.pending = [];
    this.version++;
    this.isWaiting = true;
    this.worker.postMessage({ change: { capacity: this.capacity } });
  }

  /** Take in a message of kind `cut`. */
  take(header, data, offset) {
    this.isWaiting = false;
    const part = (count) => {
      const array = new Uint32Array(data, offset, count);
      offset += 4 * count;
      return array;
    };
    const change = { header, drop: part(header.drop), runs: part(2 * header.runs), add: part(header.add), nodes: part(WORDS * header.add) };
    change.shaped = part(header.shape);
    change.shapes = part(2 * header.shape);
    change.tint = part(header.tint);
    change.colors = part(header.tint);
    change.version = ++this.version;
    this.pending.push(change);
    const floats = new Float32Array(change.nodes.buffer, change.nodes.byteOffset, change.nodes.length);
    const points = new Float32Array(3 * header.add);
    for (let i = 0; i < header.add; i++) {
      for (let k = 0; k < 3; k++) points[3 * i + k] = floats[WORDS * i + k];
    }
    const { drop, runs, add } = change;
    this.worker.postMessage({ change: { drop: drop.slice(), runs: runs.slice(), add: add.slice(), points } }, [points.buffer]);
  }

  /** Ask for the order of a view; the newest one follows when the worker is free. */
  sort(view) {
    if (this.isSorting || this.isWaiting) {
      this.next = view;
      return;
    }
    this.isSorting = true;
    this.next = null;
    this.worker.postMessage({ view, version: this.version });
  }

  sorted({ version, order, range, ms }) {
    this.isSorting = false;
    if (this.isWaiting) return;
    const rows = new Set();
    const applied = [];
    while (this.pending.length && this.pending[0].version <= version) {
      const change = this.pending.shift();
      applied.push(change.header);
      for (let i = 0; i < change.add.length; i++) {
        const slot = change.add[i], from = WORDS * i, to = WORDS * slot;
        for (let k = 0; k < WORDS; k++) this.words[to + k] = change.nodes[from + k];
        rows.add((slot / ROW) | 0);
      }
      for (let i = 0; i < change.shaped.length; i++) {
        const at = WORDS * change.shaped[i], first = change.shapes[2 * i];
        this.words[at + 3] = (this.words[at + 3] & 0xffff) | (first << 16); // opacity
        this.words[at + 6] = (this.words[at + 6] & 0xffff) | (first & 0xffff0000); // and three scales
        this.words[at + 7] = change.shapes[2 * i + 1];
        rows.add((change.shaped[i] / ROW) | 0);
      }
      for (let i = 0; i < change.tint.length; i++) {
        this.words[WORDS * change.tint[i] + 4] = change.colors[i];
        rows.add((change.tint[i] / ROW) | 0);
      }
    }
    if (applied.length) this.header = applied.at(-1);
    this.onOrder({ order, range, ms, applied, runs: runsOf(rows) });
    if (this.next) this.sort(this.next);
  }

  close() {
    this.worker.terminate();
  }
}

/** Rows of the texture as runs [first, end). */
function runsOf(rows) {
  const sorted = [...rows].sort((a, b) => a - b), runs = [];
  for (const row of sorted) {
    if (runs.length && runs.at(-1)[1] === row) runs.at(-1)[1]++;
    else runs.push([row, row + 1]);
  }
  return runs;
}
