// Drawing with WebGL2: splats front to back into sums of 16 bits a channel, then the sums over the background.
import { COVER_FRAGMENT, COVER_VERTEX, LINE_FRAGMENT, LINE_VERTEX, NODE_FRAGMENT, NODE_VERTEX } from './shaders.js';
import { ROW } from './store.js';

export const LAYERS = ['color', 'levels', 'cut', 'depth', 'alpha'];

export class Painter {
  /** Throws where there is no WebGL2 that can draw into 16-bit floats. */
  constructor(canvas) {
    const gl = canvas.getContext('webgl2', { antialias: false, alpha: false, powerPreference: 'high-performance' });
    if (!gl) throw new Error('no WebGL2');
    this.gl = gl;
    this.canvas = canvas;
    this.begin();
  }

  /** Make what every picture needs; again when a graphics processor that was lost is back. */
  begin() {
    const gl = this.gl;
    if (!gl.getExtension('EXT_color_buffer_float') && !gl.getExtension('EXT_color_buffer_half_float')) throw new Error('no float targets');
    this.nodes = program(gl, NODE_VERTEX, NODE_FRAGMENT);
    this.cover = program(gl, COVER_VERTEX, COVER_FRAGMENT);
    this.lines = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.target = { width: 0, height: 0, texture: null, framebuffer: gl.createFramebuffer() };
    this.noPicture = texture(gl, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    this.empty = gl.createVertexArray();
    this.age = (this.age ?? -1) + 1; // lines are copied again when it grows
  }

  /** Room for the nodes of one scene. */
  makeRoom(capacity) {
    const gl = this.gl;
    const room = { texture: texture(gl, gl.NEAREST), order: gl.createBuffer(), array: gl.createVertexArray(), count: 0, picture: null };
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, 2 * ROW, Math.ceil(capacity / ROW));
    gl.bindVertexArray(room.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, room.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    return room;
  }

  /** Copy the changed rows of a store and its order to the graphics processor. */
  update(room, words, runs, order) {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, room.texture);
    for (const [first, end] of runs) {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, first, 2 * ROW, end - first, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words, first * ROW * 8);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, room.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.STREAM_DRAW);
    room.count = order.length;
  }

  /** The exact picture of a room: an ImageBitmap, or null. */
  setPicture(room, bitmap) {
    const gl = this.gl;
    if (room.picture) gl.deleteTexture(room.picture);
    room.picture = null;
    if (!bitmap) return;
    room.picture = texture(gl, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
  }

  /**
   * Draw rooms side by side: `parts` is [{room, from, to, fade, range, isPicture}] with from and to as shares of the width.
   * view: {eye, axes, focal, near, width, height, dilation, antialiased, layer, depths, box, background, threshold}
   */
  draw(view, parts, lines = []) {
    const gl = this.gl;
    this.resize(view.width, view.height);
    for (const part of parts) {
      const x = Math.round(part.from * view.width), width = Math.round(part.to * view.width) - x;
      if (width <= 0) continue;
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(x, 0, width, view.height);
      if (!part.isPicture) this.drawNodes(view, part.room);
      const outX = Math.round(part.from * this.canvas.width), outWidth = Math.round(part.to * this.canvas.width) - outX;
      gl.scissor(outX, 0, outWidth, this.canvas.height);
      this.drawCover(view, part);
      gl.disable(gl.SCISSOR_TEST);
    }
    for (const line of lines) this.drawLines(view, line);
  }

  drawNodes(view, room) {
    const gl = this.gl, { program: p, at } = this.nodes;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.framebuffer);
    gl.viewport(0, 0, view.width, view.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(p);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE); // front to back
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, room.texture);
    gl.uniform1i(at('nodes'), 0);
    const high = view.eye.map(Math.fround);
    gl.uniform3fv(at('eyeHigh'), high);
    gl.uniform3fv(at('eyeLow'), view.eye.map((x, i) => x - high[i]));
    ['right', 'down', 'forward'].forEach((name, i) => gl.uniform3fv(at(name), view.axes[i]));
    gl.uniform2f(at('size'), view.width, view.height);
    gl.uniform1f(at('focal'), view.focal);
    gl.uniform1f(at('near'), view.near);
    gl.uniform1f(at('dilation'), view.dilation);
    gl.uniform1f(at('threshold'), view.threshold);
    gl.uniform1i(at('antialiased'), Number(view.antialiased));
    gl.uniform1i(at('layer'), LAYERS.indexOf(view.layer));
    gl.uniform2fv(at('depths'), view.depths);
    gl.uniform3fv(at('boxLow'), view.box ? view.box.slice(0, 3) : [-1e30, -1e30, -1e30]);
    gl.uniform3fv(at('boxHigh'), view.box ? view.box.slice(3) : [1e30, 1e30, 1e30]);
    gl.bindVertexArray(room.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, room.count);
    gl.disable(gl.BLEND);
  }

  drawCover(view, part) {
    const gl = this.gl, { program: p, at } = this.cover;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.useProgram(p);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.target.texture);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, part.room.picture ?? this.noPicture);
    gl.uniform1i(at('sums'), 0);
    gl.uniform1i(at('exact'), 1);
    gl.uniform1f(at('fade'), part.room.picture ? part.fade : 0);
    gl.uniform1i(at('layer'), LAYERS.indexOf(view.layer));
    gl.uniform2fv(at('range'), part.range);
    gl.uniform3fv(at('background'), view.background);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** line: {points: Float32Array of pairs of points, color: [r, g, b, a]} */
  drawLines(view, line) {
    const gl = this.gl, { program: p, at } = this.lines;
    if (line.age !== this.age) Object.assign(line, { age: this.age, array: gl.createVertexArray(), buffer: gl.createBuffer(), uploaded: null });
    if (line.uploaded !== line.points) {
      line.uploaded = line.points;
      gl.bindVertexArray(line.array);
      gl.bindBuffer(gl.ARRAY_BUFFER, line.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, line.points, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    }
    gl.useProgram(p);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform3fv(at('eyeHigh'), view.eye);
    ['right', 'down', 'forward'].forEach((name, i) => gl.uniform3fv(at(name), view.axes[i]));
    gl.uniform2f(at('size'), view.width, view.height);
    gl.uniform1f(at('focal'), view.focal);
    gl.uniform4fv(at('color'), line.color);
    gl.bindVertexArray(line.array);
    gl.drawArrays(gl.LINES, 0, line.points.length / 3);
    gl.disable(gl.BLEND);
  }

  /** The pixels of the canvas as drawn last, bottom row first; only right after `draw`. */
  read() {
    const gl = this.gl, pixels = new Uint8Array(4 * this.canvas.width * this.canvas.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, this.canvas.width, this.canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  }

  resize(width, height) {
    const gl = this.gl, target = this.target;
    if (target.width === width && target.height === height) return;
    if (target.texture) gl.deleteTexture(target.texture);
    target.texture = texture(gl, gl.LINEAR);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.texture, 0);
    target.width = width;
    target.height = height;
  }
}

function texture(gl, filter) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  return made;
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(made, name));
    return places.get(name);
  };
  return { program: made, at };
}
