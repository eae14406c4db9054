// Mouse, touch and keys move the camera.
//
// Mouse: left turns, right or shift pans, the wheel comes nearer, a double click sets the point to turn about. Touch: one finger
// turns, two fingers pan, pinch to come nearer. Keys: W A S D Q E fly, arrows turn, + and − come nearer and go back.
const TURN = 0.0055; // radians a px
const MOVES = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, 1, 0], KeyE: [0, -1, 0] };
const TURNS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const ZOOMS = { '+': -1, '=': -1, '-': 1 }; // by what the key writes: their places differ between keyboards
const FAST = 3; // with shift

export class Controls {
  /** `on` has functions: pivot(x, y) for a double click, key(code) of other keys, taken() when a hand moves. `mode` is 'orbit' or 'fly'. */
  constructor(canvas, camera, on) {
    this.canvas = canvas;
    this.camera = camera;
    this.on = on;
    this.mode = 'orbit';
    this.speed = 1;
    this.pointers = new Map();
    this.keys = new Map(); // held down, by their place: what each does
    this.isFast = false;
    canvas.addEventListener('pointerdown', (event) => this.down(event));
    canvas.addEventListener('pointermove', (event) => this.drag(event));
    for (const name of ['pointerup', 'pointercancel']) canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
    canvas.addEventListener('contextmenu', (event) => event.preventDefault());
    canvas.addEventListener('dblclick', (event) => on.pivot(event.offsetX, event.offsetY));
    addEventListener('keydown', (event) => this.key(event, true));
    addEventListener('keyup', (event) => this.key(event, false));
    addEventListener('blur', () => this.keys.clear());
  }

  down(event) {
    this.on.taken();
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const now = performance.now();
    if (event.pointerType === 'touch' && this.pointers.size === 1) {
      if (now - (this.tapped ?? -1e9) < 300) this.on.pivot(event.offsetX, event.offsetY);
      this.tapped = now;
    }
  }

  drag(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last) return;
    const here = [event.clientX, event.clientY], [dx, dy] = [here[0] - last[0], here[1] - last[1]];
    if (this.pointers.size >= 2) this.pinch(event.pointerId, here, dx, dy);
    else if (event.buttons & 2 || event.buttons & 4 || event.shiftKey) this.pan(dx, dy);
    else if (this.mode === 'orbit') this.camera.orbit(-dx * TURN, -dy * TURN);
    else this.camera.look(-dx * TURN * 0.5, dy * TURN * 0.5);
    this.pointers.set(event.pointerId, here);
  }

  pan(dx, dy) {
    const k = this.camera.distance() / this.camera.focal(this.canvas.clientHeight);
    this.camera.move(-dx * k, -dy * k, 0);
  }

  pinch(id, here, dx, dy) {
    const [other] = [...this.pointers].filter(([key]) => key !== id).map(([, value]) => value);
    const before = this.pointers.get(id);
    const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
    this.pan(dx / 2, dy / 2);
    const factor = apart(before) / Math.max(apart(here), 1);
    this.zoomAt((here[0] + other[0]) / 2, (here[1] + other[1]) / 2, factor);
  }

  wheel(event) {
    event.preventDefault();
    this.on.taken();
    const unit = event.deltaMode === 1 ? 33 : 1;
    const factor = Math.exp(Math.max(-120, Math.min(120, event.deltaY * unit)) * 0.0016);
    if (this.mode === 'fly') this.camera.move(0, 0, (1 - factor) * this.camera.distance());
    else this.zoomAt(event.offsetX, event.offsetY, factor);
  }

  zoomAt(x, y, factor) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.camera.zoom(factor, this.camera.through(x - width / 2, y - height / 2, height));
  }

  key(event, isDown) {
    this.isFast = event.shiftKey;
    if (!isDown) this.keys.delete(event.code); // wherever the focus is by now, and whatever else is held down
    const isTyped = event.target.closest?.('dialog, select, textarea, input:not([type=range], [type=checkbox])');
    const isSlid = event.code in TURNS && event.target.closest?.('input'); // a slider that was moved last keeps its arrows only
    if (isTyped || isSlid || event.ctrlKey || event.metaKey || event.altKey) return;
    const act = { move: MOVES[event.code], turn: TURNS[event.code], zoom: ZOOMS[event.key] };
    if (act.move || act.turn || act.zoom) {
      if (isDown) this.on.taken();
      if (isDown) this.keys.set(event.code, act);
      event.preventDefault();
    } else if (isDown && !event.repeat) this.on.key?.(event.code);
  }

  /** Move by the keys that are held down; called once a frame with the seconds since the last. */
  step(seconds) {
    if (!this.keys.size) return;
    const k = this.speed * (this.isFast ? FAST : 1) * seconds;
    const moved = [0, 0, 0];
    for (const { move, turn, zoom } of this.keys.values()) {
      move?.forEach((value, i) => (moved[i] += value));
      if (turn && this.mode === 'orbit') this.camera.orbit(-turn[0] * seconds * 1.2, -turn[1] * seconds * 1.2);
      else if (turn) this.camera.look(turn[0] * seconds, -turn[1] * seconds);
      if (zoom) this.camera.zoom(Math.exp(zoom * seconds));
    }
    if (moved.some(Boolean)) this.camera.move(moved[0] * k, moved[1] * k, moved[2] * k);
  }
}
