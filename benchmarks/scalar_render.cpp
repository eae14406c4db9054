// The same projection and blending as plain scalar loops with the C library's functions: what benchmarks/render.py compares
// with. One thread; compiled without automatic vectorisation.
#include <cmath>
#include <cstdint>

namespace {

struct Camera {
  float rotation[9], center[3], fx, fy, cx, cy, width, height, near, slope_min_x, slope_max_x, slope_min_y, slope_max_y, dilation;
};

float clamp(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

}  // namespace

// Writes the records (16 floats, kernels/shared/record.h) of the rows that touch the picture; returns their number.
extern "C" int64_t project(const float* means, const float* quats, const float* log_scales, const float* logits, const float* sh,
                           int64_t n, const double* view, float threshold, float* records) {
  Camera c;
  float* fields = reinterpret_cast<float*>(&c);
  for (int i = 0; i < 24; ++i) fields[i] = float(view[i]);
  const float* r = c.rotation;
  int64_t count = 0;
  for (int64_t i = 0; i < n; ++i) {
    const float dx = means[3 * i] - c.center[0], dy = means[3 * i + 1] - c.center[1], dz = means[3 * i + 2] - c.center[2];
    const float z = r[6] * dx + r[7] * dy + r[8] * dz;
    if (!(z > c.near)) continue;
    const float opacity = 1 / (1 + std::exp(-logits[i]));
    if (opacity < threshold) continue;
    const float ux = (r[0] * dx + r[1] * dy + r[2] * dz) / z, uy = (r[3] * dx + r[4] * dy + r[5] * dz) / z;
    const float tx = clamp(ux, c.slope_min_x, c.slope_max_x), ty = clamp(uy, c.slope_min_y, c.slope_max_y);
    float qw = quats[4 * i], qx = quats[4 * i + 1], qy = quats[4 * i + 2], qz = quats[4 * i + 3];
    const float length = std::sqrt(qw * qw + qx * qx + qy * qy + qz * qz);
    qw /= length, qx /= length, qy /= length, qz /= length;
    const float R[9] = {1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz),     2 * (qx * qz + qw * qy),
                        2 * (qx * qy + qw * qz),     1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx),
                        2 * (qx * qz - qw * qy),     2 * (qy * qz + qw * qx),     1 - 2 * (qx * qx + qy * qy)};
    float m[2][3];
    for (int j = 0; j < 3; ++j) {
      const float scale = std::exp(log_scales[3 * i + j]);
      m[0][j] = m[1][j] = 0;
      for (int k = 0; k < 3; ++k) {
        m[0][j] += c.fx / z * (r[k] - tx * r[6 + k]) * R[3 * k + j] * scale;
        m[1][j] += c.fy / z * (r[3 + k] - ty * r[6 + k]) * R[3 * k + j] * scale;
      }
    }
    float xx = c.dilation, yy = c.dilation, xy = 0;
    for (int j = 0; j < 3; ++j) xx += m[0][j] * m[0][j], yy += m[1][j] * m[1][j], xy += m[0][j] * m[1][j];
    const float det = xx * yy - xy * xy;
    const float k = std::sqrt(2 * std::log(opacity / threshold));
    const float x = c.fx * ux + c.cx, y = c.fy * uy + c.cy, ex = k * std::sqrt(xx), ey = k * std::sqrt(yy);
    if (x + ex < 0.5f || x - ex > c.width - 0.5f || y + ey < 0.5f || y - ey > c.height - 0.5f) continue;
    float* record = records + 16 * count++;
    record[0] = x, record[1] = y;
    record[2] = std::sqrt(yy / det), record[3] = -record[2] * xy / yy, record[4] = 1 / std::sqrt(yy);
    record[5] = opacity, record[6] = std::log2(opacity);
    for (int j = 0; j < 3; ++j) record[7 + j] = std::fmax(0.5f + 0.28209479f * sh[3 * i + j], 0.f);
    record[10] = z, record[11] = ex, record[12] = ey;
  }
  return count;
}

// Blends the lists of all tiles pixel by pixel.
extern "C" void blend(const float* records, const int64_t* tile_start, const int32_t* splat_from_pair, int num_tiles_x,
                      int num_tiles_y, int width, int height, float threshold, float* image) {
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const int tile = y / 16 * num_tiles_x + x / 16;
      float left = 1, color[3] = {0, 0, 0};
      for (int64_t i = tile_start[tile]; i < tile_start[tile + 1]; ++i) {
        const float* s = records + int64_t(splat_from_pair[i]) * 16;
        const float dx = x + 0.5f - s[0], dy = y + 0.5f - s[1];
        const float u = s[2] * dx + s[3] * dy, v = s[4] * dy;
        const float alpha = std::fmin(s[5] * std::exp(-0.5f * (u * u + v * v)), 0.99f);
        if (alpha < threshold) continue;
        if (left * (1 - alpha) < 1e-4f) break;
        for (int c = 0; c < 3; ++c) color[c] += left * alpha * s[7 + c];
        left *= 1 - alpha;
      }
      for (int c = 0; c < 3; ++c) image[(int64_t(y) * width + x) * 3 + c] = color[c];
    }
  (void)num_tiles_y;
}
