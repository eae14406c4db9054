// node decode_rad.cjs in.rad out.bin: decode with Spark's own WebAssembly, as its worker does, without a browser.
//
// The package holds the worker's source and the compiled decoder as strings. The output is, little-endian: u32 count, u32 length
// of the tree, the two arrays of Spark's 32-byte splats (4 u32 each a splat), its harmonics of degree 1 (4 u32 a splat), and the
// tree (4 u32 a node).
const fs = require("fs");
const vm = require("vm");

const main = require.resolve("@sparkjsdev/spark").replace(/spark\.(cjs|module)(\.min)?\.js$/, "spark.module.js");
const source = fs.readFileSync(main, "utf8");
const literal = source.match(/const jsContent = ('(?:[^'\\]|\\.)*');/)[1];
const wasm = Buffer.from(source.match(/decode64\("([A-Za-z0-9+/=]+)"\)/)[1], "base64");

let answer;
let listener;
const self = {
  addEventListener: (_, f) => { listener = f; },
  removeEventListener: () => {},
  postMessage: (data) => { if (data.result || data.error) answer(data); },
};
const worker = { self, console, ReadableStream, WebAssembly, TextDecoder, TextEncoder, Response, Request, URL, performance };

(async () => {
  vm.runInNewContext(vm.runInThisContext(literal), { ...worker, FinalizationRegistry, Uint8Array, Uint32Array, Float32Array });
  await listener({ data: { name: "init-wasm", module: await WebAssembly.compile(wasm) } });
  await new Promise((done) => setTimeout(done, 100));
  const fileBytes = new Uint8Array(fs.readFileSync(process.argv[2]));
  const found = await new Promise((done) => {
    answer = done;
    listener({ data: { id: 1, name: "loadExtSplats", args: { fileBytes, fileType: "rad" } } });
  });
  if (found.error) throw found.error;
  const { numSplats, extArrays, extra } = found.result.lodSplats ?? found.result;
  const tree = extra.lodTree ?? new Uint32Array(0);
  const arrays = [...extArrays, extra.sh1].map((a) => a.subarray(0, 4 * numSplats));
  const parts = [Uint32Array.of(numSplats, tree.length), ...arrays, tree];
  fs.writeFileSync(process.argv[3], Buffer.concat(parts.map((a) => Buffer.from(a.buffer, a.byteOffset, a.byteLength))));
})().catch((error) => { console.error(error); process.exit(1); });
