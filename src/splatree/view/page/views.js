// Cameras: those of the file, those that were kept, and recorded paths; as files, pictures and video.
import { button, make, share, tick } from './panel.js';

const RECORD_MS = 100; // between two cameras of a recorded path
const LAST_MS = 400;

export class Views {
  constructor(app, page) {
    this.app = app;
    this.page = page;
    this.given = [];
    this.kept = [];
    this.path = null;
    this.chosen = null;
  }

  rows() {
    this.list = make('div', { class: 'views' });
    this.shown = tick('Show cameras in the scene', false, () => this.showFrusta());
    this.opacity = share('Photograph', 0.6, () => this.showPhoto());
    this.opacity.hidden = true;
    return [
      this.shown, this.opacity, this.list,
      make('div', { class: 'buttons' }, button('Keep this', 'Add this camera to the list (K)', () => this.add()),
        button('Copy', 'Copy as cameras.json of the 3DGS code', () => this.page.copy(JSON.stringify(this.inria(), null, 1), 'Copied as cameras.json (3DGS).')),
        button('cameras.json', 'Save for splatree render --cameras', () => save(JSON.stringify(this.inria(), null, 1), 'cameras.json')),
        button('transforms.json', 'Save for nerfstudio', () => save(JSON.stringify(this.nerfstudio(), null, 1), 'transforms.json'))),
      make('div', { class: 'buttons' }, button('Play', 'Fly along the cameras that were kept or recorded; again, or any movement: stop', () => this.play(false)),
        button('Video', 'Fly along them and save a video', () => this.play(true)), button('Clear', 'Forget them', () => this.clear())),
    ];
  }

  async sceneCame() {
    if (this.given.length) return;
    const url = new URL('cameras.json', location.href);
    url.search = new URLSearchParams({ token: new URLSearchParams(location.search).get('token') ?? '' });
    this.given = await (await fetch(url)).json();
    this.refresh();
  }

  /** The camera of the page as a record like those of the file. */
  current(name) {
    const { canvas } = this.app.painter ?? { canvas: document.getElementById('stage') };
    return { name, c2w: this.app.camera.pose(), f: this.app.camera.focal(canvas.height), w: canvas.width, h: canvas.height, distance: this.app.camera.distance() };
  }

  add() {
    this.kept.push(this.current(`view_${String(this.kept.length).padStart(4, '0')}`));
    this.refresh();
    this.page.notice(`${this.kept.length} cameras kept`, 1500);
  }

  clear() {
    this.kept = [];
    this.refresh();
  }

  refresh() {
    const row = (camera, i, kind) => button(camera.name || `${kind} ${i}`, 'Go there', () => this.take(camera, i, kind));
    this.list.replaceChildren(...this.kept.map((camera, i) => row(camera, i, 'kept')), ...this.given.slice(0, 500).map((camera, i) => row(camera, i, 'camera')));
    this.showFrusta();
  }

  take(camera, i, kind) {
    this.chosen = camera;
    this.photo = kind === 'camera' && camera.photo ? i : null;
    this.app.camera.setPose(camera.c2w, (2 * Math.atan((0.5 * camera.h) / camera.f) * 180) / Math.PI);
    this.placeOfChosen = this.place();
    this.versionOfChosen = this.app.camera.version;
    this.showFrusta();
    this.showPhoto();
  }

  place() {
    return [...this.app.camera.pose(), this.app.camera.fov].join();
  }

  showFrusta() {
    this.page.showFrusta(this.shown?.input.checked && this.app.facts ? [...this.given, ...this.kept] : [], this.chosen);
  }

  /** The photograph of the camera that was taken, over the picture, in the place that it saw. */
  showPhoto() {
    const holder = document.getElementById('photo');
    const isShown = this.photo != null;
    this.opacity.hidden = !isShown;
    holder.hidden = !isShown;
    if (!isShown) return;
    if (holder.dataset.number !== String(this.photo)) {
      holder.dataset.number = String(this.photo);
      const url = new URL(`photo/${this.photo}`, location.href);
      url.search = new URLSearchParams({ token: new URLSearchParams(location.search).get('token') ?? '' });
      holder.replaceChildren(make('img', { src: url.href, alt: this.chosen.name }));
    }
    const height = innerHeight, width = (height * this.chosen.w) / this.chosen.h;
    Object.assign(holder.style, { width: `${width}px`, left: `${(innerWidth - width) / 2}px`, opacity: this.opacity.querySelector('input').value });
  }

  step(now) {
    if (this.photo != null && this.app.camera.version !== this.versionOfChosen) {
      this.versionOfChosen = this.app.camera.version;
      if (this.place() !== this.placeOfChosen) this.photo = null; // else the window has another size, or a setting has changed
      this.showPhoto();
    }
    if (this.path && now - (this.recordedAt ?? 0) >= RECORD_MS) {
      this.recordedAt = now;
      this.path.push(this.current(`path_${String(this.path.length).padStart(4, '0')}`));
    }
    if (this.flight) this.fly(now);
  }

  toggleRecording() {
    if (this.path) {
      this.kept = this.path;
      this.path = null;
      this.page.notice(`${this.kept.length} cameras recorded: Play, Video or cameras.json in the settings under Cameras`, 5000);
      this.refresh();
    } else {
      this.path = [];
      this.page.notice('Recording: move about, then press C again.', 3000);
    }
    this.page.record.setAttribute('aria-pressed', String(Boolean(this.path)));
  }

  play(isVideo) {
    if (this.flight) return this.stop();
    const views = this.kept.length > 1 ? this.kept : this.given;
    if (views.length < 2) {
      this.page.notice('Keep two cameras or record a path first.', 3000);
      return;
    }
    this.flight = { views, start: null, recorder: isVideo ? this.recorder() : null };
  }

  recorder() {
    const stream = document.getElementById('stage').captureStream(30), parts = [];
    const type = ['video/webm', 'video/mp4'].find((name) => MediaRecorder.isTypeSupported(name));
    const recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: 12e6 });
    recorder.ondataavailable = (event) => parts.push(event.data);
    recorder.onstop = () => save(new Blob(parts, { type }), `splatree.${type.split('/')[1]}`);
    recorder.start();
    return recorder;
  }

  fly(now) {
    const { views } = this.flight;
    this.flight.start ??= now;
    const step = views.length > 20 ? RECORD_MS : 1500, place = (now - this.flight.start) / step;
    const i = Math.min(views.length - 2, Math.floor(place)), t = Math.min(1, place - i);
    const eased = views.length > 20 ? t : t * t * (3 - 2 * t), blend = (a, b) => a.map((x, k) => (1 - eased) * x + eased * b[k]);
    const m = blend(views[i].c2w, views[i + 1].c2w), fovOf = (v) => (2 * Math.atan((0.5 * v.h) / v.f) * 180) / Math.PI;
    this.app.camera.setPose(orthonormal(m), (1 - eased) * fovOf(views[i]) + eased * fovOf(views[i + 1]));
    if (place >= views.length - 1) this.stop();
  }

  /** End the flight, and its video with the picture that it ends on. */
  stop() {
    const recorder = this.flight?.recorder;
    this.flight = null;
    if (recorder) setTimeout(() => recorder.stop(), LAST_MS); // the last picture stays for a moment
  }

  savePicture() {
    this.app.isDirty = true;
    if (this.app.painter) this.app.draw();
    document.getElementById('stage').toBlob((blob) => save(blob, `${document.title.split(' ')[0]}.png`));
  }

  all() {
    const centre = this.app.facts.centre;
    const views = this.kept.length ? this.kept : [this.current('view_0000')];
    return views.map((view) => ({ ...view, c2w: view.c2w.map((x, i) => (i % 4 === 3 ? x + centre[(i / 4) | 0] : x)) }));
  }

  /** The list of cameras.json of the 3DGS code. */
  inria() {
    const near = this.app.facts.near;
    return this.all().map(({ name, c2w: m, f, w, h }, id) => ({
      id, img_name: name, width: w, height: h, position: [m[3], m[7], m[11]],
      rotation: [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]], fx: f, fy: f, ...(near === 0.2 ? {} : { near }),
    }));
  }

  /** transforms.json of nerfstudio, whose axes are OpenGL's. */
  nerfstudio() {
    const frames = this.all().map(({ name, c2w: m, f, w, h }) => ({
      file_path: name, fl_x: f, fl_y: f, cx: w / 2, cy: h / 2, w, h,
      transform_matrix: [0, 1, 2].map((r) => [m[4 * r], -m[4 * r + 1], -m[4 * r + 2], m[4 * r + 3]]).concat([[0, 0, 0, 1]]),
    }));
    return { camera_model: 'PINHOLE', frames };
  }
}

/** The pose with its axes at right angles again, after a blend of two. */
function orthonormal(m) {
  const column = (i) => [m[i], m[4 + i], m[8 + i]];
  const unit = (v) => v.map((x) => x / (Math.hypot(...v) || 1));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const z = unit(column(2)), x = unit(cross(column(1), z)), y = cross(z, x);
  return [0, 1, 2].flatMap((r) => [x[r], y[r], z[r], m[4 * r + 3]]);
}

function save(content, name) {
  const blob = content instanceof Blob ? content : new Blob([content], { type: 'application/json' });
  const link = make('a', { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
