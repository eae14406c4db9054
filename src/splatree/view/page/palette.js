// Colours of depths in the tree, from coarse (violet) over teal to fine (yellow).
export const STOPS = [[0.27, 0.13, 0.46], [0.19, 0.41, 0.6], [0.12, 0.6, 0.54], [0.5, 0.8, 0.34], [0.99, 0.88, 0.2]];

/** The colour of a depth as CSS; `range` is the depth of the first and of the last colour. */
export function levelColor(depth, [low, high]) {
  const place = Math.max(0, Math.min(1, (depth - low) / Math.max(1, high - low))) * (STOPS.length - 1);
  const i = Math.min(STOPS.length - 2, Math.floor(place)), t = place - i;
  return `rgb(${STOPS[i].map((x, k) => Math.round(255 * ((1 - t) * x + t * STOPS[i + 1][k]))).join(' ')})`;
}
