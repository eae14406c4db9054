// node decode_ksplat.mjs in.ksplat out.bin: decode with GaussianSplats3D's own SplatBuffer.
//
// The output is, little-endian: u32 count, u32 degree, then for each splat 3 f32 centre, 3 f32 scale, 4 f32 rotation xyzw, 4 f32
// RGBA of 0 to 255, and its harmonics, for each coefficient RGB.
import { createRequire } from "module";
import { pathToFileURL } from "url";
import fs from "fs";

globalThis.window = globalThis;
const require = createRequire(import.meta.url);
const main = require.resolve("@mkkellogg/gaussian-splats-3d").replace(/[^/]*$/, "gaussian-splats-3d.module.js");
const { SplatBuffer } = await import(pathToFileURL(main));

const bytes = fs.readFileSync(process.argv[2]);
const buffer = new SplatBuffer(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
const n = buffer.getSplatCount();
const degree = buffer.getMinSphericalHarmonicsDegree();
const numRest = 3 * ((degree + 1) ** 2 - 1);
const rest = new Float32Array(n * numRest);
if (degree > 0) buffer.fillSphericalHarmonicsArray(rest, degree, undefined, undefined, undefined, undefined, 0);
const vector = () => ({
  set(x, y, z, w) { Object.assign(this, { x, y, z, w }); return this; },
  copy(v) { return this.set(v.x, v.y, v.z, v.w); },
});
const rows = new Float32Array(n * (14 + numRest));
for (let i = 0; i < n; i++) {
  const [centre, scale, rotation, color] = [vector(), vector(), vector(), vector()];
  buffer.getSplatCenter(i, centre);
  buffer.getSplatScaleAndRotation(i, scale, rotation);
  buffer.getSplatColor(i, color);
  const values = [centre.x, centre.y, centre.z, scale.x, scale.y, scale.z, rotation.x, rotation.y, rotation.z, rotation.w];
  rows.set([...values, color.x, color.y, color.z, color.w, ...rest.subarray(i * numRest, (i + 1) * numRest)], i * (14 + numRest));
}
fs.writeFileSync(process.argv[3], Buffer.concat([Buffer.from(Uint32Array.of(n, degree).buffer), Buffer.from(rows.buffer)]));
