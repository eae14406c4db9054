// A .rad in Spark, chunk by chunk. The scene is turned by half a circle about x, since three.js has y up.
import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { SparkRenderer, SplatMesh } from '@sparkjsdev/spark';
import { fail, fov, number, position, state, stream, target } from './query.js';

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

const spark = new SparkRenderer({ renderer, lodSplatCount: number('budget', 1e6) });
const mesh = new SplatMesh({ url: stream, paged: true });
mesh.quaternion.set(1, 0, 0, 0);
scene.add(spark, mesh);
const turned = ([x, y, z]) => new THREE.Vector3(x, -y, -z);
const controls = position ? null : new OrbitControls(camera, renderer.domElement);
camera.position.copy(turned(position ?? [target[0], target[1] - 1, target[2] - 3]));
camera.lookAt(turned(target));
controls?.target.copy(turned(target));
state.stop = () => renderer.setAnimationLoop(null);
mesh.initialized.then(() => {
  if (!controls) return;
  const box = mesh.getBoundingBox?.(true);
  if (!box || box.isEmpty()) return;
  const centre = box.getCenter(new THREE.Vector3()).applyQuaternion(mesh.quaternion);
  const size = box.getSize(new THREE.Vector3()).length() / 2;
  controls.target.copy(centre);
  camera.position.copy(centre).add(new THREE.Vector3(0, 0.3 * size, size));
}, fail);

let quiet = 0;
let before = -1;
renderer.setAnimationLoop(() => {
  controls?.update();
  renderer.render(scene, camera);
  const drawn = spark.activeSplats;
  const wanted = mesh.paged ? mesh.paged.numSplats : drawn;
  const loading = spark.pager?.fetchers?.length ?? 0;
  quiet = drawn > 0 && drawn === before && drawn === wanted && loading === 0 ? quiet + 1 : 0;
  before = drawn;
  Object.assign(state, { drawn, loading, ready: quiet > 4 });
});
