// What the graphics processor runs. Nodes are projected as in splatree's own renderer (kernels/reference/project.py).
import { STOPS } from './palette.js';

export const NODE_VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp usampler2D;
uniform usampler2D nodes;
uniform vec3 eyeHigh, eyeLow;        // the eye, relative to the centre of the scene, as two floats
uniform vec3 right, down, forward;   // axes of the camera
uniform vec2 size;                   // of the picture, px
uniform float focal, near, dilation, threshold;
uniform bool antialiased;
uniform int layer;                   // 0 colours, 1 levels, 2 cut, 3 depth
uniform vec2 depths;                 // of the first and of the last colour of levels
uniform vec3 boxLow, boxHigh;
layout(location = 0) in uint slot;
out vec2 sigmas; out vec4 color;
const float HALF_ROOT = 0.70710678;

const vec3 STOPS[${STOPS.length}] = vec3[](${STOPS.map((stop) => `vec3(${stop.join(', ')})`).join(', ')});
vec3 levelColor(float t) {
  float place = clamp(t, 0., 1.) * float(${STOPS.length - 1});
  int i = min(int(place), ${STOPS.length - 2});
  return mix(STOPS[i], STOPS[i + 1], place - float(i));
}

void main() {
  ivec2 at = ivec2((int(slot) & ${1023}) * 2, int(slot) >> 10);
  uvec4 a = texelFetch(nodes, at, 0), b = texelFetch(nodes, at + ivec2(1, 0), 0);
  gl_Position = vec4(0., 0., 2., 1.);
  vec3 mean = uintBitsToFloat(a.xyz);
  if (any(lessThan(mean, boxLow)) || any(greaterThan(mean, boxHigh))) return;
  vec3 d = (mean - eyeHigh) - eyeLow;
  vec3 t = vec3(dot(right, d), dot(down, d), dot(forward, d));
  if (!(t.z > near)) return;

  ivec3 low = (ivec3(b.yzw) << 16) >> 16, high = ivec3(b.yzw) >> 16;
  vec3 small = vec3(low.x, high.x, low.y) * (HALF_ROOT / 32767.);
  float rest = sqrt(max(0., 1. - dot(small, small)));
  uint which = a.w & 3u;
  vec4 q = which == 0u ? vec4(rest, small) : which == 1u ? vec4(small.x, rest, small.yz)
         : which == 2u ? vec4(small.xy, rest, small.z) : vec4(small, rest);   // w x y z
  vec3 logs = vec3(uvec3(b.z >> 16, b.w & 65535u, b.w >> 16)) * (20. / 32767.5) - 20.;
  vec3 scale = min(exp(logs), vec3(5e8 / focal * t.z));
  float w = q.x, x = q.y, y = q.z, z = q.w;
  vec3 ax = vec3(1. - 2. * (y * y + z * z), 2. * (x * y + w * z), 2. * (x * z - w * y)) * scale.x;
  vec3 ay = vec3(2. * (x * y - w * z), 1. - 2. * (x * x + z * z), 2. * (y * z + w * x)) * scale.y;
  vec3 az = vec3(2. * (x * z + w * y), 2. * (y * z - w * x), 1. - 2. * (x * x + y * y)) * scale.z;

  vec2 slope = t.xy / t.z, limit = 0.65 * size / focal, u = clamp(slope, -limit, limit);
  vec3 tx = focal / t.z * (right - u.x * forward), ty = focal / t.z * (down - u.y * forward);
  vec3 mx = vec3(dot(tx, ax), dot(tx, ay), dot(tx, az)), my = vec3(dot(ty, ax), dot(ty, ay), dot(ty, az));
  float xx = dot(mx, mx), yy = dot(my, my), xy = dot(mx, my);
  vec3 c = cross(mx, my);
  float bare = dot(c, c), det = bare + dilation * (xx + yy) + dilation * dilation;
  xx += dilation; yy += dilation;

  float opacity = float(a.w >> 16) / 65535.;
  if (antialiased) opacity *= sqrt(bare / det);
  if (opacity < threshold) return;
  float k = sqrt(2. * log(opacity * 255.));

  float middle = 0.5 * (xx + yy), root = sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.));
  float major = middle + root, minor = det / major;                 // eigenvalues; no difference of large numbers
  vec2 axis = abs(xy) > 1e-6 * major ? normalize(vec2(xy, major - xx)) : (xx >= yy ? vec2(1., 0.) : vec2(0., 1.));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2. - 1.;
  sigmas = k * corner;
  vec2 offset = sigmas.x * sqrt(major) * axis + sigmas.y * sqrt(minor) * vec2(-axis.y, axis.x);
  vec2 px = focal * slope + offset;
  if (any(greaterThan(abs(focal * slope) - k * sqrt(vec2(xx, yy)), 0.5 * size))) return;
  gl_Position = vec4(2. * px.x / size.x, -2. * px.y / size.y, 0., 1.);

  uint level = (a.w >> 8) & 127u;
  bool leaf = ((a.w >> 15) & 1u) == 1u;
  vec3 shown = vec3(uvec3(b.x & 2047u, (b.x >> 11) & 2047u, b.x >> 22)) * vec3(2. / 2047., 2. / 2047., 2. / 1023.);
  float grey = dot(shown, vec3(0.3, 0.6, 0.1));
  if (layer == 1) shown = levelColor((float(level) - depths.x) / max(depths.y - depths.x, 1.)) * (0.4 + 0.75 * grey);
  if (layer == 2) shown = (leaf ? vec3(0.42, 0.86, 0.55) : vec3(1.0, 0.62, 0.22)) * (0.3 + 0.7 * grey);
  if (layer == 3) shown = vec3(log(t.z));
  color = vec4(shown, opacity);
}`;

export const NODE_FRAGMENT = `#version 300 es
precision highp float;
in vec2 sigmas; in vec4 color; out vec4 share;
void main() {
  float alpha = min(0.99, color.a * exp(-0.5 * dot(sigmas, sigmas)));
  if (alpha < 1. / 255.) discard;
  share = vec4(color.rgb * alpha, alpha);
}`;

export const COVER_VERTEX = `#version 300 es
out vec2 place;
void main() { vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.; place = p; gl_Position = vec4(2. * p - 1., 0., 1.); }`;

// The sums of the splats over the background, mixed with the exact picture of the server.
export const COVER_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D sums, exact;
uniform float fade;
uniform int layer;
uniform vec2 range;
uniform vec3 background;
in vec2 place; out vec4 pixel;
void main() {
  vec4 sum = texture(sums, place);
  vec3 shown = sum.rgb + (1. - sum.a) * background;
  if (layer == 4) shown = vec3(sum.a);
  if (layer == 3) {
    float t = (log(range.y) - sum.r / max(sum.a, 1e-4)) / max(log(range.y) - log(range.x), 1e-5);
    shown = vec3(sum.a < 0.05 ? 0. : 0.08 + 0.92 * clamp(t, 0., 1.));
  }
  if (fade > 0.) shown = mix(shown, texture(exact, vec2(place.x, 1. - place.y)).rgb, fade);
  pixel = vec4(shown, 1.);
}`;

export const LINE_VERTEX = `#version 300 es
precision highp float;
uniform vec3 eyeHigh, right, down, forward;
uniform vec2 size; uniform float focal;
layout(location = 0) in vec3 point;
void main() {
  vec3 d = point - eyeHigh;
  float z = dot(forward, d);
  gl_Position = vec4(2. * focal * dot(right, d) / size.x, -2. * focal * dot(down, d) / size.y, 0., z);
}`;

export const LINE_FRAGMENT = `#version 300 es
precision mediump float;
uniform vec4 color; out vec4 pixel;
void main() { pixel = color; }`;
