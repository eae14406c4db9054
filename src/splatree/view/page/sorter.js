// A worker that keeps the means of one scene's nodes and orders them by depth, nearest first.
//
// Depths are ordered by their bits as float32: for numbers of one sign these ascend with the number, so two passes of counting
// over 16 bits each are a full sort. About 12 ms for 300,000 nodes.
let means = new Float32Array(0), live = new Uint8Array(0), active = new Uint32Array(0);
const counts = new Uint32Array(65537);

function apply({ drop, runs, add, points, capacity }) {
  if (capacity) {
    means = new Float32Array(3 * capacity);
    live = new Uint8Array(capacity);
    active = new Uint32Array(0);
    return;
  }
  for (const slot of drop) live[slot] = 0;
  for (let i = 0; i < runs.length; i += 2) live.fill(0, runs[i], runs[i] + runs[i + 1]);
  for (let i = 0; i < add.length; i++) {
    const slot = add[i];
    live[slot] = 1;
    means[3 * slot] = points[3 * i];
    means[3 * slot + 1] = points[3 * i + 1];
    means[3 * slot + 2] = points[3 * i + 2];
  }
  let n = 0;
  for (let slot = 0; slot < live.length; slot++) n += live[slot];
  active = new Uint32Array(n);
  n = 0;
  for (let slot = 0; slot < live.length; slot++) if (live[slot]) active[n++] = slot;
}

function pass(keys, shift, from, to, indices) {
  const n = from.length;
  counts.fill(0);
  for (let i = 0; i < n; i++) counts[((keys[i] >>> shift) & 0xffff) + 1]++;
  for (let k = 0; k < 65536; k++) counts[k + 1] += counts[k];
  for (let j = 0; j < n; j++) {
    const i = from[j];
    to[counts[(keys[i] >>> shift) & 0xffff]++] = indices ? indices[i] : i;
  }
}

function sort({ eye, forward, near }) {
  const n = active.length, slots = new Uint32Array(n), depths = new Float32Array(n), keys = new Uint32Array(depths.buffer);
  let m = 0;
  for (let i = 0; i < n; i++) {
    const at = 3 * active[i];
    const depth = (means[at] - eye[0]) * forward[0] + (means[at + 1] - eye[1]) * forward[1] + (means[at + 2] - eye[2]) * forward[2];
    if (depth > near) {
      depths[m] = depth;
      slots[m++] = active[i];
    }
  }
  const first = new Uint32Array(m), order = new Uint32Array(m), indices = new Uint32Array(m);
  for (let i = 0; i < m; i++) indices[i] = i;
  pass(keys, 0, indices, first, null);
  pass(keys, 16, first, order, slots);
  const depthOf = (slot) => (means[3 * slot] - eye[0]) * forward[0] + (means[3 * slot + 1] - eye[1]) * forward[1] + (means[3 * slot + 2] - eye[2]) * forward[2];
  const range = m ? [depthOf(order[(0.02 * m) | 0]), depthOf(order[(0.98 * (m - 1)) | 0])] : [1, 2];
  return { order, range };
}

onmessage = (event) => {
  const said = event.data;
  if (said.change) apply(said.change);
  if (said.view) {
    const start = performance.now();
    const { order, range } = sort(said.view);
    postMessage({ version: said.version, order, range, ms: performance.now() - start }, [order.buffer]);
  }
};
