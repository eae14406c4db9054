// Line segments of boxes and cameras, as pairs of points relative to the centre of the scene.
const EDGES = [0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7];

/** The twelve edges of each box; six numbers a box: low corner, high corner. */
export function boxLines(boxes) {
  const count = boxes.length / 6, points = new Float32Array(count * EDGES.length * 3);
  let out = 0;
  for (let b = 0; b < count; b++) {
    for (const corner of EDGES) {
      for (let k = 0; k < 3; k++) points[out++] = boxes[6 * b + k + 3 * ((corner >> k) & 1)];
    }
  }
  return points;
}

/** A pyramid for each camera {c2w, f, w, h}, `size` deep. */
export function frusta(cameras, size) {
  const points = [];
  for (const { c2w: m, f, w, h } of cameras) {
    const at = (x, y, z) => [0, 1, 2].map((row) => m[4 * row] * x + m[4 * row + 1] * y + m[4 * row + 2] * z + m[4 * row + 3]);
    const x = (0.5 * w * size) / f, y = (0.5 * h * size) / f;
    const eye = at(0, 0, 0), corners = [at(-x, -y, size), at(x, -y, size), at(x, y, size), at(-x, y, size)];
    corners.forEach((corner, i) => points.push(...eye, ...corner, ...corner, ...corners[(i + 1) % 4]));
    points.push(...at(-0.5 * x, -y, size), ...at(0, -1.4 * y, size), ...at(0, -1.4 * y, size), ...at(0.5 * x, -y, size)); // which way is up
  }
  return new Float32Array(points);
}
