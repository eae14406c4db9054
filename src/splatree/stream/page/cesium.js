// 3D Tiles in CesiumJS. Tiles have z up; the scene's y down and z forward become z up and −y.
import { fail, fov, number, position, state, stream, target, up } from './query.js';

const C = window.Cesium;
C.Ion.defaultAccessToken = '';
const webgl = { preserveDrawingBuffer: true };
const widget = new C.CesiumWidget('cesium', {
  baseLayer: false, globe: false, skyBox: false, skyAtmosphere: false, contextOptions: { webgl }, msaaSamples: 1,
});
const scene = widget.scene;
scene.backgroundColor = C.Color.BLACK;
scene.fog.enabled = false;
scene.highDynamicRange = false;
state.stop = () => { widget.useDefaultRenderLoop = false; };

const settings = { maximumScreenSpaceError: number('sse', 16) };
const tileset = await C.Cesium3DTileset.fromUrl(stream, settings).catch(fail);
if (tileset) {
  scene.primitives.add(tileset);
  const matrix = C.Matrix4.clone(tileset.root.computedTransform);
  const tile = ([x, y, z]) => new C.Cartesian3(-x, -z, -y);
  const point = (v) => C.Matrix4.multiplyByPoint(matrix, tile(v), new C.Cartesian3());
  const along = (v) => C.Cartesian3.normalize(
    C.Matrix4.multiplyByPointAsVector(matrix, tile(v), new C.Cartesian3()), new C.Cartesian3());
  const aspect = innerWidth / innerHeight;
  const tangent = Math.tan((fov * Math.PI) / 360);
  scene.camera.frustum.fov = 2 * Math.atan(tangent * Math.max(1, aspect));
  scene.camera.frustum.near = 0.01;
  if (position) {
    const direction = along(target.map((x, i) => x - position[i]));
    const right = C.Cartesian3.normalize(C.Cartesian3.cross(direction, along(up), new C.Cartesian3()), new C.Cartesian3());
    const above = C.Cartesian3.cross(right, direction, new C.Cartesian3());
    scene.camera.setView({ destination: point(position), orientation: { direction, up: above } });
  } else {
    widget.zoomTo(tileset);
  }
  let quiet = 0;
  scene.postRender.addEventListener(() => {
    // Splats are sorted by a worker before they are drawn: a while after tiles have come, fewer are drawn than are selected.
    const drawn = tileset.gaussianSplatPrimitive?._numSplats ?? 0;
    const selected = tileset._selectedTiles.reduce((sum, tile) => sum + (tile.content?.pointsLength ?? 0), 0);
    quiet = drawn > 0 && drawn === selected && tileset.tilesLoaded ? quiet + 1 : 0;
    Object.assign(state, { drawn, tiles: tileset.statistics.selected, ready: quiet > 20 });
  });
}
