// A .rad in Spark, chunk by chunk. The scene is turned by half a circle about x, since three.js has y up.
import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { SparkRenderer, SplatMesh } from '@sparkjsdev/spark';
import { fail, fov, mode, number, position, state, stream, target, turns, up } from './query.js';

const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setPixelRatio(1);
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(fov, 1, 0.01, 10000);
const fit = () => {
  renderer.setSize(innerWidth, innerHeight);
  camera.aspect = innerWidth / innerHeight;
  camera.updateProjectionMatrix();
};
addEventListener('resize', fit);
fit();

// Spark's own blur makes splats fainter, too, as scenes with antialiasing are trained.
const blur = mode === 'classic' ? { preBlurAmount: 0.3, blurAmount: 0 } : {};
const spark = new SparkRenderer({ renderer, lodSplatCount: number('budget', 1e6), ...blur });
const mesh = new SplatMesh({ url: stream, paged: true });
mesh.quaternion.set(1, 0, 0, 0);
scene.add(spark, mesh);
const turned = ([x, y, z]) => new THREE.Vector3(x, -y, -z);
camera.position.copy(turned(position ?? [target[0], target[1] - 1, target[2] - 3]));
camera.up.copy(turned(up));
camera.lookAt(turned(target));
const controls = turns ? new OrbitControls(camera, renderer.domElement) : null; // it takes the camera's up
controls?.target.copy(turned(target));
state.stop = () => renderer.setAnimationLoop(null);
mesh.initialized.then(() => {
  if (position) return;
  const box = mesh.getBoundingBox?.(true);
  if (!box || box.isEmpty()) return;
  const centre = box.getCenter(new THREE.Vector3()).applyQuaternion(mesh.quaternion);
  const size = box.getSize(new THREE.Vector3()).length() / 2;
  controls.target.copy(centre);
  camera.position.copy(centre).add(new THREE.Vector3(0, 0.3 * size, size));
}, fail);

// Spark sorts in the background: what is drawn follows what is chosen some frames later, less what lies outside the view.
let changed = performance.now();
let before = '';
renderer.setAnimationLoop(() => {
  controls?.update();
  renderer.render(scene, camera);
  const drawn = spark.activeSplats;
  const loading = spark.pager?.fetchers?.length ?? 0;
  const now = `${drawn} ${mesh.paged?.numSplats} ${loading}`;
  if (now !== before || drawn === 0 || loading > 0) changed = performance.now();
  before = now;
  const quietMs = performance.now() - changed;
  Object.assign(state, { drawn, chosen: mesh.paged?.numSplats, loading, quietMs, ready: quietMs > 3000 });
});
