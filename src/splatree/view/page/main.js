// The viewer: asks for the cut of the camera, draws it, and shows the server's exact picture once the camera is still.
import { Camera, glide } from './camera.js';
import { Controls } from './controls.js';
import { Layer } from './layer.js';
import { Painter } from './painter.js';
import { Page } from './page.js';
import { readAddress, writeAddress } from './address.js';
import { mix } from './vectors.js';

const STILL_MS = 300; // without a change before the exact picture is asked for
const FADE_MS = 250;
const GUARD = 0.08; // share of the picture that a cut covers beyond each border
const SLOW_FRAMES = 6; // in a row that take longer than 200 ms: the server draws from then on

const settings = JSON.parse(document.body.dataset.settings);
const query = new URLSearchParams(location.search);
const canvas = document.getElementById('stage');
const isPhone = matchMedia('(pointer: coarse) and (max-width: 820px), (pointer: coarse) and (max-height: 480px)').matches;

class App {
  constructor() {
    this.camera = new Camera();
    this.state = {
      budget: Number(query.get('budget')) || (isPhone ? Math.min(settings.budget, 150_000) : settings.budget),
      tau: settings.tau,
      occlusion: settings.occlusion, // what is hidden is drawn more coarsely
      db: settings.db, // PSNR that is wanted of each cut, in place of τ; null: by τ
      layer: 'color',
      background: 'theme',
      exact: query.get('exact') !== '0',
      leaves: false,
      resolution: 1, // pixels of the picture for each of the window, along each side
      box: null,
      split: 0.5,
    };
    this.still = { since: 0, asked: false };
    this.painter = null; // null: this browser draws no nodes
    this.frames = settings.frames || query.get('renderer') === 'frames'; // the server draws
    if (!this.frames) {
      try {
        this.painter = new Painter(canvas);
      } catch (error) {
        this.frames = true;
        this.reason = `${error.message}: pictures are drawn by the server`;
      }
    }
    this.context = this.painter ? null : canvas.getContext('2d');
    this.stats = { frames: 0, fps: 0, slow: 0, psnr: null, first: null };
    this.lines = {};
    this.page = new Page(this, settings);
    this.controls = new Controls(canvas, this.camera, {
      pivot: (x, y) => this.askPoint(x, y),
      key: (code) => this.page.key(code),
      taken: () => this.stopMotion(),
    });
    const on = {
      scene: (layer, isFirst) => this.sceneCame(layer, isFirst),
      cut: (layer) => this.sort(layer),
      drawn: (layer, applied) => this.cutDrawn(layer, applied),
      frame: (layer, header) => this.frameCame(layer, header),
      point: (point) => point && (this.motion = glide(this.camera, this.camera.eye, point)),
      boxes: (header, boxes) => this.page.boxesCame(header, boxes),
      look: (header) => this.camera.setPose(header.c2w, header.fov),
      notice: (text) => this.page.notice(text),
    };
    const capacity = isPhone ? 1 << 19 : settings.capacity;
    this.layers = settings.scenes.map((_, i) => new Layer(i, capacity, this.painter, on));
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener('webglcontextlost', (event) => this.graphicsLost(event));
    canvas.addEventListener('webglcontextrestored', () => this.graphicsBack());
    this.resize();
    if (this.reason) this.page.notice(this.reason, 6000);
    requestAnimationFrame((now) => this.tick(now));
  }

  get facts() {
    return this.layers[0].facts;
  }

  resize() {
    const ratio = this.state.resolution * Math.min(devicePixelRatio || 1, isPhone ? 2 : 1.5);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    this.camera.version++;
  }

  /** The graphics processor was taken away, as phones do to pages in the background; it may come back. */
  graphicsLost(event) {
    event.preventDefault(); // else it never comes back
    this.isBlind = true;
    this.page.notice('The graphics of this machine are gone for the moment; waiting for them …');
  }

  graphicsBack() {
    this.painter.begin();
    for (const layer of this.layers) layer.restore();
    this.isBlind = false;
    this.page.notice('');
    this.changed();
  }

  /** A scene came, the first one or a new one in its place. */
  sceneCame(layer, isFirst) {
    if (layer === this.layers[0] && isFirst) {
      this.camera.up = layer.facts.up;
      this.camera.fov = layer.facts.fov;
      this.camera.set(this.firstEye(), layer.facts.target);
      this.controls.speed = layer.facts.radius * (layer.facts.inside ? 0.3 : 0.6);
      if (layer.facts.inside) this.page.fly.click(); // from within, one looks round
      readAddress(this.camera, this.state);
    }
    this.page.sceneCame(layer);
    this.changed();
  }

  /** Something of the view is different: cuts and pictures have to be asked for again. */
  changed() {
    this.camera.version++;
  }

  view() {
    const { width, height } = canvas;
    return {
      eye: this.camera.eye,
      axes: this.camera.axes(),
      focal: this.camera.focal(height),
      near: this.facts.near,
      width,
      height,
      dilation: 0.3,
      threshold: 1 / 255,
      antialiased: this.facts.mode === 'antialiased',
      layer: this.state.layer,
      depths: this.depthRange(),
      box: this.state.box,
      background: this.page.background(),
    };
  }

  /** Depths in the tree between which nearly all nodes of the cut lie, for the colours of levels. */
  depthRange() {
    const levels = this.layers[0].header?.levels ?? [1], total = levels.reduce((a, b) => a + b, 0);
    let below = 0;
    const low = levels.findIndex((count) => (below += count) > 0.02 * total);
    return [Math.max(0, low), Math.max(1, levels.length - 1)];
  }

  request(layer) {
    return {
      c2w: this.camera.pose(),
      f: this.camera.focal(canvas.height),
      w: canvas.width,
      h: canvas.height,
      near: layer.facts.near,
      budget: Math.min(this.state.budget, layer.facts.capacity),
      tau: this.state.tau,
      db: layer.facts.levels > 1 ? this.state.db : null,
      occlusion: layer.facts.occlusion && this.state.occlusion,
      guard: GUARD,
    };
  }

  sort(layer) {
    const [, , forward] = this.camera.axes();
    layer.store.sort({ eye: this.camera.eye, forward, near: this.facts.near });
  }

  cutDrawn(layer, applied) {
    if (applied.length) this.stats.first ??= performance.now();
    this.isDirty = true;
    this.page.showStatus();
  }

  /** The exact pictures, once the camera is still and the last cut is drawn. */
  askExact(now) {
    if (this.still.asked || now - this.still.since < STILL_MS || (!this.frames && !this.state.exact)) return;
    if (!this.frames && !this.layers.every((layer) => layer.isSettled)) return;
    if (this.state.layer === 'levels' || this.state.layer === 'cut') return;
    this.still.asked = true;
    for (const layer of this.layers) this.askPicture(layer, 1, true);
  }

  askPicture(layer, factor, isExact) {
    const request = this.request(layer);
    layer.askFrame({
      ...request,
      w: Math.max(1, Math.round(request.w * factor)),
      h: Math.max(1, Math.round(request.h * factor)),
      f: request.f * factor,
      ...(this.frames ? {} : { held: !this.state.leaves, tau: 0, db: null, occlusion: false }), // of the cut on the screen, or of all leaves
      budget: this.frames ? Math.max(1000, Math.round(request.budget * (isExact ? 1 : factor))) : layer.facts.capacity,
      layer: this.state.layer,
      background: this.page.background(),
      box: this.state.box,
      moving: !isExact,
      packing: isExact && !isPhone ? 'png' : 'jpeg',
      quality: isExact ? 95 : 75,
    }, isExact);
  }

  frameCame(layer, header) {
    layer.frameAt = performance.now();
    if (this.frames) this.showPicture(layer);
    else if (this.state.layer === 'color' && !this.state.leaves) this.stats.psnr = null;
    this.isDirty = true;
    this.page.showStatus();
  }

  /** Who draws from now on: 'browser' or 'server'. */
  setDrawer(name) {
    this.frames = name === 'server';
    this.stats.slow = 0;
    this.changed();
  }

  /** A picture of the server is all that is seen. Sizes while moving follow the time that a picture takes. */
  showPicture(layer) {
    layer.isWaiting = false;
    const took = layer.frameHeader.took;
    this.factor = Math.min(1, Math.max(0.25, (this.factor ?? 0.5) * (took > 140 ? 0.8 : took < 70 ? 1.15 : 1)));
    if (this.painter) {
      layer.fade = 1;
      this.painter.draw(this.view(), this.parts().map((part) => ({ ...part, isPicture: true })), this.page.linesDrawn());
    } else this.drawPicture(layer);
    this.stats.frames++;
    this.countFrame(performance.now());
  }

  /** The same without WebGL2. */
  drawPicture(layer) {
    const width = Math.round(this.state.split * canvas.width), isPair = this.layers.length > 1;
    this.context.imageSmoothingQuality = 'high';
    this.context.save();
    if (isPair) {
      this.context.beginPath();
      this.context.rect(layer === this.layers[0] ? 0 : width, 0, layer === this.layers[0] ? width : canvas.width - width, canvas.height);
      this.context.clip();
    }
    this.context.drawImage(layer.bitmap, 0, 0, canvas.width, canvas.height);
    this.context.restore();
  }

  askPoint(x, y) {
    const ratio = canvas.width / canvas.clientWidth;
    const layer = this.layers.at(x / canvas.clientWidth > this.state.split ? -1 : 0);
    layer.link.want({ ...this.request(layer), want: 'point', at: [x * ratio, y * ratio], box: this.state.box });
  }

  /** The point in the middle of the picture, of the first scene where two share it, becomes the one to turn about. */
  askMiddle() {
    this.askPoint(canvas.clientWidth / 2, canvas.clientHeight / 2);
  }

  /** A hand takes the camera: a glide or a flight ends where it is. */
  stopMotion() {
    this.motion = null;
    this.page.views.stop();
  }

  reset() {
    this.camera.fov = this.facts.fov;
    this.camera.frame = null;
    this.motion = glide(this.camera, this.firstEye(), this.facts.target);
  }

  /** Where the first view is taken from: farther away in a narrow window, so that the scene's width is in it. */
  firstEye() {
    const { eye, target, inside, aspect } = this.facts;
    return mix(target, eye, inside ? 1 : Math.max(1, (aspect * canvas.clientHeight) / canvas.clientWidth));
  }

  tick(now) {
    requestAnimationFrame((next) => this.tick(next));
    if (window.__stop || !this.facts || this.isBlind) return;
    const seconds = Math.min(0.1, (now - (this.lastTick ?? now)) / 1000);
    this.lastTick = now;
    this.controls.step(seconds);
    if (this.motion?.(now)) this.motion = null;
    this.page.step?.(now);
    if (this.camera.version !== this.seenVersion) {
      this.seenVersion = this.camera.version;
      this.still = { since: now, asked: false };
      this.stats.psnr = null;
      this.isDirty = true;
      const wasExact = this.layers.some((layer) => layer.isExact);
      for (const layer of this.layers) {
        layer.drop(this.frames);
        layer.isStale = true;
        if (layer.store && !this.frames) this.sort(layer);
      }
      if (wasExact) this.page.showStatus();
    }
    if (this.frames) this.tickFrames(now);
    else this.tickCuts(now);
    if (!this.addressWritten && now - this.still.since > 400) {
      this.addressWritten = true;
      writeAddress(this.camera, this.state);
    }
    if (now - this.still.since < 50) this.addressWritten = false;
  }

  tickFrames(now) {
    if (this.isDirty && this.painter && this.layers.every((layer) => layer.room.picture)) {
      this.painter.draw(this.view(), this.parts().map((part) => ({ ...part, fade: 1, isPicture: true })), this.page.linesDrawn());
    }
    for (const layer of this.layers) {
      if (layer.isStale && !layer.isWaiting && layer.facts) {
        layer.isStale = false;
        layer.isWaiting = true;
        this.askPicture(layer, this.factor ?? 0.5, false);
      }
    }
    this.isDirty = false;
    if (this.layers.every((layer) => !layer.isWaiting)) this.askExact(now);
  }

  tickCuts(now) {
    for (const layer of this.layers) {
      if (layer.isStale && layer.facts && layer.askCut(this.request(layer), now)) layer.isStale = false;
    }
    this.askExact(now);
    for (const layer of this.layers) {
      const fade = layer.bitmap ? Math.min(1, (performance.now() - layer.frameAt) / FADE_MS) : 0;
      if (fade !== layer.fade) this.isDirty = true;
      layer.fade = fade;
    }
    if (!this.isDirty) {
      this.lastDraw = null;
      return;
    }
    this.isDirty = false;
    this.draw();
    this.countFrame(now);
  }

  draw() {
    const view = this.view();
    if (this.stats.psnr === null && this.layers.every((layer) => layer.bitmap) && this.state.layer === 'color' && !this.state.leaves) {
      this.painter.draw(view, this.parts().map((part) => ({ ...part, fade: 0 })));
      this.stats.psnr = this.page.compare(this.painter.read(), this.layers);
      this.page.showStatus();
    }
    this.painter.draw(view, this.parts(), this.page.linesDrawn());
    this.stats.frames++;
  }

  parts() {
    return this.layers.map((layer, i) => ({
      room: layer.room,
      range: layer.range,
      fade: layer.fade,
      from: i === 0 ? 0 : this.state.split,
      to: i === this.layers.length - 1 ? 1 : this.state.split,
    }));
  }

  /** Frames a second, and whether the graphics of this machine are too slow to draw the nodes. */
  countFrame(now) {
    if (this.lastDraw != null) {
      const took = now - this.lastDraw;
      this.stats.fps = this.stats.fps ? 0.9 * this.stats.fps + 0.1 * (1000 / Math.max(took, 1)) : 1000 / Math.max(took, 1);
      this.stats.slow = took > 200 ? this.stats.slow + 1 : 0;
      if (!this.frames && this.stats.slow >= SLOW_FRAMES && query.get('renderer') !== 'webgl') this.page.serverDraws();
    }
    this.lastDraw = now;
  }

  /** For tests and scripts: take a place. */
  go(eye, target, up = this.camera.up) {
    this.camera.up = up;
    this.camera.set(eye, target);
  }

  /** Whether the newest camera and all that came in is on the screen. */
  get isSeen() {
    return !this.isDirty && this.camera.version === this.seenVersion;
  }

  /** Whether the newest cut is drawn; without WebGL2, whether the exact picture is. */
  get isReady() {
    if (this.frames) return this.isExact;
    return this.isSeen && this.layers.every((layer) => layer.isSettled && !layer.isStale);
  }

  /** Whether the exact picture is all that is seen. */
  get isExact() {
    return this.isSeen && this.layers.every((layer) => layer.isExact && !layer.isStale && (this.frames || layer.fade === 1));
  }
}

window.splatree = new App();
