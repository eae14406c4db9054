// A streamed SOG in the PlayCanvas engine. The scene is turned by half a circle about z, since the engine has y up.
import * as pc from 'playcanvas';
import { CameraControls } from 'controls';
import { dilation, fail, fov, lod, mode, number, position, state, stream, target, turns, up } from './query.js';

const canvas = document.getElementById('canvas');
const device = await pc.createGraphicsDevice(canvas, { deviceTypes: ['webgl2'], antialias: false });
const options = new pc.AppOptions();
options.graphicsDevice = device;
options.mouse = new pc.Mouse(canvas);
options.touch = new pc.TouchDevice(canvas);
options.keyboard = new pc.Keyboard(window);
options.componentSystems = [pc.CameraComponentSystem, pc.GSplatComponentSystem, pc.ScriptComponentSystem];
options.resourceHandlers = [pc.GSplatHandler, pc.TextureHandler, pc.ContainerHandler, pc.ScriptHandler];
const app = new pc.AppBase(canvas);
app.init(options);
app.setCanvasFillMode(pc.FILLMODE_FILL_WINDOW);
app.setCanvasResolution(pc.RESOLUTION_AUTO);
app.start();
app.scene.gsplat.splatBudget = number('budget', 1e6);
// The engine widens splats by a variance of 0.3 in half pixels, a quarter of what scenes are trained with, in px²: small splats
// come out too thin, and some not at all.
const chunks = pc.ShaderChunks.get(device, pc.SHADERLANGUAGE_GLSL);
chunks.set('gsplatCornerVS', chunks.get('gsplatCornerVS').replaceAll('+ 0.3', `+ ${(4 * dilation).toFixed(6)}`));
app.scene.gsplat.antiAlias = mode === 'antialiased';
if (lod === 'error') app.scene.gsplat.lodMode = pc.GSPLAT_LODMODE_ERROR;
state.stop = () => { app.autoRender = false; };

const asset = new pc.Asset('stream', 'gsplat', { url: stream });
app.assets.add(asset);
asset.once('error', fail);
asset.once('load', () => {
  const entity = new pc.Entity('scene');
  entity.addComponent('gsplat', { asset, unified: true });
  entity.setLocalEulerAngles(0, 0, 180);
  app.root.addChild(entity);

  const turned = ([x, y, z]) => new pc.Vec3(-x, -y, z);
  const box = entity.gsplat.customAabb ?? asset.resource?.aabb;
  const aim = position || !box ? target : box.center.toArray();
  const away = box ? box.halfExtents.length() : 3;
  const eye = position ?? [aim[0], aim[1] - 0.3 * away, aim[2] - away];
  const camera = new pc.Entity('camera');
  camera.addComponent('camera', { clearColor: new pc.Color(0, 0, 0, 1), fov, nearClip: 0.01, farClip: 10000 });
  camera.camera.toneMapping = pc.TONEMAP_LINEAR;
  camera.camera.gammaCorrection = pc.GAMMA_SRGB;
  app.root.addChild(camera);
  camera.setPosition(turned(eye));
  camera.lookAt(turned(aim), turned(up));
  if (turns) {
    camera.addComponent('script');
    camera.script.create(CameraControls)?.reset(turned(aim), turned(eye));
  }

  let quiet = 0;
  app.systems.gsplat.on('frame:ready', (_camera, _layer, ready, pending) => {
    quiet = ready && pending === 0 ? quiet + 1 : 0;
    Object.assign(state, { pending, drawn: app.stats.frame.gsplats, ready: quiet > 3 });
  });
});
app.assets.load(asset);
