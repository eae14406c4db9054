// How near the browser's picture is to the server's exact one.

/** PSNR in dB of pixels as WebGL reads them (bottom row first) against bitmaps that share the width at `split`. */
export function psnr(pixels, bitmaps, split) {
  const { width, height } = bitmaps[0];
  if (pixels.length !== 4 * width * height) return null;
  const surface = new OffscreenCanvas(width, height), context = surface.getContext('2d', { willReadFrequently: true });
  const border = bitmaps.length > 1 ? Math.round(split * width) : width;
  context.drawImage(bitmaps[0], 0, 0);
  if (bitmaps.length > 1) context.drawImage(bitmaps[1], border, 0, width - border, height, border, 0, width - border, height);
  const exact = context.getImageData(0, 0, width, height).data;
  let sum = 0;
  for (let y = 0; y < height; y++) {
    for (let i = 4 * width * y, j = 4 * width * (height - 1 - y), end = i + 4 * width; i < end; i += 4, j += 4) {
      for (let k = 0; k < 3; k++) sum += (exact[i + k] - pixels[j + k]) ** 2;
    }
  }
  return 10 * Math.log10((255 ** 2 * 3 * width * height) / Math.max(sum, 1e-9));
}
