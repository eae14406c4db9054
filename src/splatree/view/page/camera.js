// The camera of the page: an eye, the point it turns about, and what is up. Axes are OpenCV's: right, down, forward.
import { across, add, cross, dot, length, mix, scale, sub, turn, unit } from './vectors.js';

const GLIDE_MS = 450;
const STEEPEST = 0.9998; // cosine of the smallest angle between the view and `up`

export class Camera {
  constructor() {
    this.eye = [0, 0, -3];
    this.target = [0, 0, 0];
    this.up = [0, -1, 0];
    this.fov = 50; // vertical, degrees
    this.frame = null; // right, down, forward where the horizon is not level, as in a camera of a file
    this.version = 0; // grows with each change
  }

  /** right, down, forward: unit vectors of the world. */
  axes() {
    if (this.frame) return this.frame;
    const forward = unit(sub(this.target, this.eye));
    let right = cross(forward, this.up);
    right = length(right) < 1e-6 ? across(forward) : unit(right);
    return [right, cross(forward, right), forward];
  }

  distance() {
    return length(sub(this.target, this.eye));
  }

  focal(height) {
    return (0.5 * height) / Math.tan((this.fov * Math.PI) / 360);
  }

  /** Three rows of four: the pose in the world, as the server wants it. */
  pose() {
    const [r, d, f] = this.axes();
    return [r[0], d[0], f[0], this.eye[0], r[1], d[1], f[1], this.eye[1], r[2], d[2], f[2], this.eye[2]];
  }

  set(eye, target, frame = null) {
    this.eye = eye;
    this.target = target;
    this.frame = frame;
    this.version++;
  }

  /** Take a pose; the point to turn about stays as far away as it is. */
  setPose(m, fov = this.fov) {
    const column = (i) => [m[i], m[4 + i], m[8 + i]];
    const eye = column(3), forward = column(2);
    this.fov = fov;
    this.set(eye, add(eye, scale(forward, this.distance())), [column(0), column(1), forward]);
  }

  /** Turn about the target by angles in radians. */
  orbit(yaw, pitch) {
    const offset = sub(this.eye, this.target);
    this.set(add(this.target, this.turned(offset, yaw, pitch)), this.target);
  }

  /** Turn the view about the eye. */
  look(yaw, pitch) {
    const ahead = sub(this.target, this.eye);
    this.set(this.eye, add(this.eye, this.turned(ahead, yaw, -pitch)));
  }

  turned(v, yaw, pitch) {
    const [right] = this.axes();
    let turnedV = turn(v, this.up, yaw);
    const axis = turn(right, this.up, yaw);
    const tilted = turn(turnedV, axis, pitch);
    if (Math.abs(dot(unit(tilted), this.up)) < STEEPEST) turnedV = tilted;
    return turnedV;
  }

  /** Move eye and target by parts of the distance: right, down, forward. */
  move(right, down, forward) {
    const [r, d, f] = this.axes();
    const step = add(add(scale(r, right), scale(d, down)), scale(f, forward));
    this.set(add(this.eye, step), add(this.target, step), this.frame);
  }

  /** Come nearer by a factor below 1 to a point that stays where it is in the picture. */
  zoom(factor, point = this.target) {
    this.set(mix(point, this.eye, factor), mix(point, this.target, factor), this.frame);
  }

  /** Where the ray through a pixel meets the plane of the target; x and y from the centre of the picture in px. */
  through(x, y, height) {
    const [r, d, f] = this.axes();
    const k = this.distance() / this.focal(height);
    return add(this.eye, add(scale(f, this.distance()), add(scale(r, x * k), scale(d, y * k))));
  }
}

/**
 * A glide from one place to another, a jump for whoever wants less motion: returns a function of the time in ms that moves the
 * camera and says whether it is done.
 */
export function glide(camera, eye, target) {
  const duration = matchMedia('(prefers-reduced-motion: reduce)').matches ? 0 : GLIDE_MS;
  const from = { eye: camera.eye, target: camera.target };
  let start = null;
  return (now) => {
    start ??= now;
    const t = duration ? Math.min(1, (now - start) / duration) : 1, eased = t * t * (3 - 2 * t);
    camera.set(mix(from.eye, eye, eased), mix(from.target, target, eased));
    return t === 1;
  };
}
