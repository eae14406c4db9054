// What surrounds the picture: title, status, tools, settings, help.
import { address } from './address.js';
import { boxLines, frusta } from './lines.js';
import { bytes, button, choice, count, make, named, section, share, slider, tick } from './panel.js';
import { levelColor } from './palette.js';
import { psnr } from './psnr.js';
import { Views } from './views.js';

const at = (id) => document.getElementById(id);
const UPS = { '−y': [0, -1, 0], '+y': [0, 1, 0], '+z': [0, 0, 1], '−z': [0, 0, -1], '+x': [1, 0, 0], '−x': [-1, 0, 0] };
const BACKGROUNDS = { dark: [0.043, 0.051, 0.063], light: [0.957, 0.961, 0.949], black: [0, 0, 0], white: [1, 1, 1] };
const LINES = {
  dark: { boxes: [0.55, 0.9, 0.65], clip: [0.95, 0.76, 0.3], cameras: [0.45, 0.7, 1], chosen: [1, 0.75, 0.3] },
  light: { boxes: [0, 0.4, 0.2], clip: [0.7, 0.42, 0], cameras: [0.1, 0.3, 0.85], chosen: [0.85, 0.35, 0] },
};
const ICONS = {
  orbit: 'M20 12a8 8 0 1 1-2.6-5.9M20 3.5v4h-4M12 10.5a1.5 1.5 0 1 0 .01 0', fly: 'M3.5 11.5 20.5 4l-6 16.5-3-6.5zM11.5 14l4-4.5',
  home: 'M4 11.5 12 4l8 7.5M6 10v9.5h4.5V14h3v5.5H18V10', shot: 'M4 8h4l1.8-2.5h4.4L16 8h4v11H4zM12 10a3.3 3.3 0 1 0 .01 0',
  share: 'M12 15V4M8 7.5 12 4l4 3.5M6 11H5v8.5h14V11h-1', record: 'M12 4a8 8 0 1 0 .01 0M12 9a3 3 0 1 0 .01 0',
  theme: 'M13 4a8 8 0 1 0 7 9.5A6.2 6.2 0 0 1 13 4', help: 'M12 3.8a8.2 8.2 0 1 0 .01 0M9.6 9.5a2.5 2.5 0 1 1 3.5 2.4c-.8.4-1.1.9-1.1 1.8M12 16.6h.01',
  panel: 'M4 8h8M17 8h3M4 16h3M12 16h8M14.5 5.5v5M9.5 13.5v5',
};

export class Page {
  constructor(app, settings) {
    this.app = app;
    this.settings = settings;
    this.views = new Views(app, this);
    document.documentElement.dataset.theme = remembered('theme') ?? (matchMedia('(prefers-color-scheme: light)').matches ? 'light' : 'dark');
    at('name').textContent = settings.scenes.join('  |  ');
    document.title = `${settings.scenes[0]} · splatree`;
    if (new URLSearchParams(location.search).has('noui')) document.body.classList.add('bare');
    addEventListener('keydown', (event) => document.body.classList.toggle('tabbed', event.code === 'Tab')); // keys that fly draw no border
    at('help').addEventListener('keydown', (event) => {
      if (event.code === 'KeyH') at('help').close();
    });
    this.makeTools();
    this.makePanel();
    this.makeDivider();
  }

  icon(name, hint, onclick) {
    const svg = `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${ICONS[name]}"/></svg>`;
    const made = make('button', { type: 'button', class: 'icon', title: hint, 'aria-label': hint, onclick });
    made.innerHTML = svg;
    return made;
  }

  makeTools() {
    const mode = (name) => () => {
      this.app.controls.mode = name;
      this.orbit.setAttribute('aria-pressed', String(name === 'orbit'));
      this.fly.setAttribute('aria-pressed', String(name === 'fly'));
    };
    this.orbit = this.icon('orbit', 'Orbit: drag turns about the scene (1)', mode('orbit'));
    this.fly = this.icon('fly', 'Fly: W A S D Q E move, drag looks round (2)', mode('fly'));
    this.record = this.icon('record', 'Record a path of cameras (C)', () => this.views.toggleRecording());
    this.settingsIcon = this.icon('panel', 'Settings (O)', () => this.toggleSettings());
    this.settingsIcon.setAttribute('aria-expanded', 'false');
    at('tools').append(
      this.orbit, this.fly, this.icon('home', 'First view (R)', () => this.app.reset()),
      make('i'),
      this.icon('shot', 'Save the picture (P)', () => this.views.savePicture()), this.record,
      this.icon('share', 'Copy the address of this view (L)', () => this.copy(address(this.app.camera, this.app.state), 'The address of this view is copied.')),
      make('i'),
      this.icon('theme', 'Dark or light (T)', () => this.toggleTheme()), this.icon('help', 'Help (H)', () => this.help()),
      this.settingsIcon,
    );
    this.orbit.setAttribute('aria-pressed', 'true');
  }

  key(code) {
    const keys = {
      KeyR: () => this.app.reset(), KeyP: () => this.views.savePicture(), KeyC: () => this.views.toggleRecording(), KeyT: () => this.toggleTheme(),
      KeyH: () => this.help(), KeyO: () => this.toggleSettings(), KeyF: () => this.app.askMiddle(), Escape: () => this.toggleSettings(false), KeyL: () => this.copy(address(this.app.camera, this.app.state), 'The address of this view is copied.'),
      Digit1: () => this.orbit.click(), Digit2: () => this.fly.click(), KeyK: () => this.views.add(),
    };
    keys[code]?.();
  }

  toggleSettings(isOpen = !document.body.classList.contains('open')) {
    document.body.classList.toggle('open', isOpen);
    this.settingsIcon.setAttribute('aria-expanded', String(isOpen));
  }

  makePanel() {
    const { state } = this.app, set = (name) => (value) => {
      state[name] = value;
      this.app.changed();
    };
    this.budget = slider('Nodes', { low: 20_000, high: 2_000_000, value: state.budget, show: count, hint: 'Most nodes that are drawn' }, set('budget'));
    this.tau = slider('τ', { low: 0.5, high: 200, value: Math.max(0.5, state.tau), show: (v) => `${v} px`, hint: 'A node that looks at most this large stands for all below it' }, set('tau'));
    this.db = slider('Quality', { low: 25, high: 50, value: state.db ?? 40, show: (v) => `${v} dB`, hint: 'How near the cut shall be to all leaves: PSNR, measured where the camera has moved' }, set('db'));
    this.by = choice('Detail by', [['tau', 'τ', 'By the size of a node on the screen'], ['db', 'Quality', 'By the PSNR against all leaves']], state.db ? 'db' : 'tau', (kind) => this.setDetail(kind));
    this.detail = named('Detail by', this.by);
    this.layers = choice('Show', [['color', 'Colour'], ['levels', 'Levels', 'Depth in the tree: violet is coarse, yellow is fine'], ['cut', 'Cut', 'Green: leaves. Orange: merged nodes'], ['depth', 'Depth', 'Near is bright'], ['alpha', 'Alpha', 'How much of the background is covered']].filter(([key]) => this.app.painter || !['levels', 'cut'].includes(key)), 'color', set('layer'));
    this.drawer = choice('Drawn by', [['browser', 'Browser', 'WebGL2 draws the nodes'], ['server', 'Server', 'Pictures come from the server: smaller ones while moving']], this.app.frames ? 'server' : 'browser', (name) => {
      this.app.setDrawer(name);
      document.body.classList.toggle('server', name === 'server');
    });
    document.body.classList.toggle('server', this.app.frames);
    const resolution = slider('Resolution', { low: 0.25, high: 2, value: 1, show: (v) => `${Math.round(100 * v)} %`, hint: 'Pixels of the picture for each of the window' }, (value) => {
      state.resolution = value;
      this.app.resize();
    });
    this.exact = tick('Exact picture when still', state.exact, set('exact'), 'The server draws the same cut with splatree itself');
    this.leaves = tick('… of all leaves', state.leaves, set('leaves'), 'The full scene, without levels of detail');
    this.occlusion = tick('Hidden parts coarsely', state.occlusion, set('occlusion'), 'What nearer ones hide gets fewer nodes, what is seen gets more; the server takes longer for a view');
    this.histogram = make('div', { class: 'histogram', title: 'Nodes of the cut by depth in the tree' });
    this.facts = make('dl', { class: 'facts' });
    const up = choice('Up', Object.keys(UPS).map((name) => [name, name]), '−y', (name) => {
      this.app.camera.up = UPS[name];
      this.app.camera.frame = null;
      this.app.changed();
    });
    this.up = up;
    const fov = slider('Field of view', { low: 10, high: 120, value: 50, show: (v) => `${Math.round(v)}°` }, (value) => {
      this.app.camera.fov = value;
      this.app.changed();
    });
    const background = choice('Background', [['theme', 'Theme'], ['black', 'Black'], ['white', 'White']], 'theme', set('background'));
    const boxes = choice('Boxes', [['none', 'None'], ['blocks', 'Blocks', 'Runs of 256 rows: what the selection looks at'], ['chunks', 'Chunks', 'What a stream of this scene is cut into'], ['clusters', 'Clusters', 'What culling leaves out whole']], 'none', (kind) => this.showBoxes(kind));
    this.clip = tick('Clipping box', false, (isOn) => this.setClip(isOn));
    this.clipRows = make('div', { class: 'clip', hidden: true });
    at('panel').append(
      section('Detail', true, this.budget, this.detail, this.tau, this.db, this.occlusion, resolution, this.exact, this.leaves, this.histogram),
      section('Show', true, named('Layer', this.layers), ...(this.app.painter ? [named('Boxes', boxes), named('Drawn by', this.drawer)] : []), named('Background', background)),
      section('Scene', false, named('Up', up), fov, this.clip, this.clipRows, this.facts),
      section('Cameras', false, ...this.views.rows()),
    );
  }

  sceneCame(layer) {
    const { facts } = layer, first = this.app.layers[0] === layer;
    if (!first) return;
    const close = Object.entries(UPS).sort((a, b) => dotOf(b[1], facts.up) - dotOf(a[1], facts.up))[0][0];
    this.up.pick(close, true);
    const rows = { leaves: count(facts.leaves), nodes: count(facts.nodes), levels: facts.levels, harmonics: `degree ${facts.degree}`, drawn: facts.mode, radius: facts.radius.toPrecision(4) };
    this.facts.replaceChildren(...Object.entries(rows).flatMap(([name, value]) => [make('dt', {}, name), make('dd', {}, String(value))]));
    this.budget.setValue(this.app.state.budget);
    this.tau.setValue(Math.max(0.5, this.app.state.tau));
    this.occlusion.input.checked = this.app.state.occlusion;
    this.db.setValue(this.app.state.db ?? 40);
    this.showDetail();
    if (!facts.sure) this.notice('Which way is up is a guess. “Up” under Scene in the settings changes it.', 6000);
    this.views.sceneCame();
  }

  /** Cuts follow τ or a quality; a quality where there are levels. */
  setDetail(kind) {
    this.app.state.db = kind === 'db' ? (this.app.state.db ?? 40) : null;
    this.db.setValue(this.app.state.db ?? 40);
    this.showDetail();
    this.app.changed();
  }

  showDetail() {
    const hasLevels = this.app.facts?.levels > 1, isByQuality = hasLevels && Boolean(this.app.state.db);
    this.by.pick(isByQuality ? 'db' : 'tau', true);
    this.detail.hidden = !hasLevels;
    this.occlusion.hidden = !(hasLevels && this.app.layers.some((layer) => layer.facts?.occlusion));
    this.tau.hidden = isByQuality;
    this.db.hidden = !isByQuality;
  }

  showStatus() {
    const { app } = this, headers = app.layers.map((layer) => (app.frames ? layer.frameHeader : layer.header)), [header] = headers;
    if (!headers.every(Boolean)) return;
    const each = (show) => headers.map(show).join(' | '); // of two scenes side by side
    const total = app.layers.reduce((sum, l) => sum + l.link.bytes, 0);
    const isExact = app.layers.every((l) => l.isExact);
    const isPacked = app.layers.some((l) => l.frameHeader?.type === 'image/jpeg'); // for a slow line or a phone
    const ofSplatree = `This is the picture of splatree itself${isPacked ? ', packed as JPEG' : ''}`;
    const parts = [
      ['nodes', each((h) => count(h.rows))], ['visited', each((h) => count(h.visited))],
      ['τ', `${each((h) => (h.tau == null ? '∞' : h.tau.toPrecision(3)))} px`], ['loaded', bytes(total)],
      ['server', `${each((h) => Math.round(app.frames ? h.draw_ms + h.encode_ms : h.select_ms + h.pack_ms))} ms`],
      ['fps', app.stats.fps ? app.stats.fps.toFixed(app.stats.fps < 10 ? 1 : 0) : '–'],
    ];
    at('status').replaceChildren(
      make('span', { class: 'lamp', 'data-on': String(isExact), title: isExact ? ofSplatree : 'Drawn by the browser' }),
      make('span', { class: 'exact' }, isExact ? 'exact' : app.frames ? 'moving' : 'live'),
      ...(isExact && app.stats.psnr && !app.frames ? [make('span', { class: 'stat psnr', title: 'How near the picture of the browser was' }, make('em', {}, 'browser'), `${app.stats.psnr.toFixed(1)} dB`)] : []),
      ...parts.map(([name, value]) => make('span', { class: `stat ${name}` }, make('em', {}, name), value)),
    );
    if (header.levels) this.showLevels(header.levels);
  }

  showLevels(levels) {
    const most = Math.max(...levels, 1), depth = Math.max(levels.length, this.app.facts.levels);
    this.histogram.replaceChildren(...Array.from({ length: depth }, (_, i) => {
      const bar = make('b', { title: `depth ${i}: ${(levels[i] ?? 0).toLocaleString()} nodes` });
      if (this.app.state.layer === 'levels') bar.style.background = levelColor(i, this.app.depthRange());
      bar.style.height = `${Math.max(levels[i] ? 4 : 0, (100 * (levels[i] ?? 0)) / most)}%`;
      return bar;
    }));
  }

  background() {
    const name = this.app.state.background;
    return BACKGROUNDS[name === 'theme' ? document.documentElement.dataset.theme : name];
  }

  /** The lines in colours that stand out from the background. */
  linesDrawn() {
    const [r, g, b] = ['depth', 'alpha'].includes(this.app.state.layer) ? BACKGROUNDS.black : this.background();
    const colors = LINES[r + g + b > 1.5 ? 'light' : 'dark'];
    return Object.entries(this.app.lines).map(([name, line]) => Object.assign(line, { color: [...colors[name], line.alpha] }));
  }

  toggleTheme() {
    const { dataset } = document.documentElement;
    dataset.theme = dataset.theme === 'dark' ? 'light' : 'dark';
    remember('theme', dataset.theme);
    this.app.changed();
  }

  /** PSNR between the browser's picture and the exact ones of the layers, in dB. */
  compare(pixels, layers) {
    return psnr(pixels, layers.map((layer) => layer.bitmap), this.app.state.split);
  }

  showBoxes(kind) {
    delete this.app.lines.boxes;
    this.boxes = kind;
    if (kind !== 'none') this.askBoxes();
    this.app.isDirty = true;
  }

  askBoxes() {
    const layer = this.app.layers[0];
    if (layer.facts) layer.link.want({ ...this.app.request(layer), want: 'boxes', boxes: this.boxes });
  }

  boxesCame(header, boxes) {
    if (header.of !== this.boxes) return;
    if (!header.count) this.notice(`This scene has no ${this.boxes}.`, 3000);
    this.app.lines.boxes = { points: boxLines(boxes), alpha: Math.min(0.8, 5 / Math.sqrt(header.count)) }; // of many, the scene shines through
    this.app.isDirty = true;
  }

  setClip(isOn) {
    const { facts, state } = this.app;
    if (isOn && facts) {
      const r = facts.radius * 1.5;
      const low = [0, 0, 0], high = [1, 1, 1];
      const rows = ['x', 'y', 'z'].flatMap((axis, i) => [
        share(`${axis} from`, 0, (v) => put(i, v, Math.max(v, high[i]))),
        share(`${axis} to`, 1, (v) => put(i, Math.min(v, low[i]), v)),
      ]);
      const put = (i, from, to) => {
        [low[i], high[i]] = [from, to]; // a side that meets the other one takes it along
        rows[2 * i].setValue(from);
        rows[2 * i + 1].setValue(to);
        state.box = [...low.map((v) => -r + 2 * r * v), ...high.map((v) => -r + 2 * r * v)];
        this.app.lines.clip = { points: boxLines(new Float32Array(state.box)), alpha: 0.9 };
        this.app.changed();
      };
      this.clipRows.replaceChildren(...rows);
      put(0, 0, 1);
    } else {
      state.box = null;
      delete this.app.lines.clip;
      this.app.changed();
    }
    this.clipRows.hidden = !isOn;
  }

  makeDivider() {
    if (this.settings.scenes.length < 2) {
      this.app.state.split = 1;
      return;
    }
    const divider = at('divider');
    divider.hidden = false;
    const put = (share) => {
      this.app.state.split = Math.min(0.98, Math.max(0.02, share));
      divider.style.left = `${100 * this.app.state.split}%`;
      divider.setAttribute('aria-valuenow', Math.round(100 * this.app.state.split));
      this.app.stats.psnr = null;
      this.app.isDirty = true;
    };
    divider.addEventListener('pointerdown', (event) => divider.setPointerCapture(event.pointerId));
    divider.addEventListener('pointermove', (event) => event.buttons && put(event.clientX / innerWidth));
    divider.addEventListener('keydown', (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.code];
      if (!step) return;
      event.stopPropagation(); // else the camera turns too
      put(this.app.state.split + step);
    });
    put(0.5);
  }

  /** The graphics here are slow: let the server draw, and say so. */
  serverDraws() {
    this.drawer.pick('server');
    this.notice('This browser draws fewer than 5 pictures a second: the server draws now. “Drawn by” in the settings changes it.', 8000);
  }

  notice(content, duration = 0) {
    const notice = at('notice');
    clearTimeout(this.noticeTimer);
    notice.hidden = !content;
    notice.replaceChildren(content || '');
    if (content && duration) this.noticeTimer = setTimeout(() => (notice.hidden = true), duration);
  }

  async copy(text, said) {
    const copied = await navigator.clipboard?.writeText(text).then(() => true, () => false);
    if (copied || copyBySelection(text)) return this.notice(said, 2500);
    this.notice('This browser does not permit copying; the text is in the console.', 4000);
    console.info(text);
  }

  help() {
    const fingers = [
      ['one finger', 'turn about the scene, or look round while flying'], ['two fingers', 'move across'], ['pinch', 'come nearer to what lies between the fingers'],
      ['double tap', 'turn about this point'],
    ];
    const mouse = [
      ['drag', 'turn about the scene, or look round while flying'], ['right drag, shift drag', 'move across'], ['wheel', 'come nearer to what is under the pointer'],
      ['double click', 'turn about this point'],
    ];
    const keys = [
      ['W A S D, Q E', 'fly; with shift three times as fast'], ['arrows', 'turn'], ['+, −', 'come nearer, go back'], ['F', 'turn about the middle of the picture'], ['R', 'first view'], ['1, 2', 'orbit, fly'], ['K', 'add this camera to the list'],
      ['C', 'record a path'], ['P', 'save the picture'], ['L', 'copy the address of this view'], ['T', 'dark or light'], ['O', 'settings'], ['H', 'this list'],
    ];
    const rows = matchMedia('(pointer: coarse)').matches ? fingers : [...mouse, ...keys]; // a phone has no keys
    const close = button('Close', 'Close', () => at('help').close());
    at('help').replaceChildren(make('h2', {}, 'Moving about'), make('dl', {}, ...rows.flatMap(([key, text]) => [make('dt', {}, key), make('dd', {}, text)])), close);
    at('help').showModal();
  }

  step(now) {
    this.views.step(now);
    if (this.boxes && this.boxes !== 'none' && this.app.layers[0].header !== this.boxesOf && this.app.layers[0].isSettled) {
      this.boxesOf = this.app.layers[0].header;
      this.askBoxes();
    }
  }

  showFrusta(cameras, chosen) {
    delete this.app.lines.cameras;
    delete this.app.lines.chosen;
    if (cameras.length) {
      const size = this.app.facts.radius * 0.06;
      this.app.lines.cameras = { points: frusta(cameras.filter((camera) => camera !== chosen), size), alpha: 0.8 };
      if (chosen) this.app.lines.chosen = { points: frusta([chosen], size), alpha: 1 };
    }
    this.app.isDirty = true;
  }
}

/** What this page was told before, or null: browsers that keep no data for pages in frames of others throw. */
function remembered(name) {
  try {
    return localStorage.getItem(`splatree.${name}`);
  } catch {
    return null;
  }
}

function remember(name, value) {
  try {
    localStorage.setItem(`splatree.${name}`, value);
  } catch {} // it holds for this visit only
}

/** The older way to copy: pages that came without TLS from another machine have no other. */
function copyBySelection(text) {
  const field = make('textarea', { readonly: true, style: 'position: fixed; opacity: 0' }, text);
  document.body.append(field);
  field.select();
  const copied = document.execCommand('copy');
  field.remove();
  return copied;
}

function dotOf(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
