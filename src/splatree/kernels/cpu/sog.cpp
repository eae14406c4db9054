#include "cpu/sog.h"

#include <cmath>
#include <limits>

#include "cpu/pool.h"

namespace splatree {
namespace {

constexpr int64_t kRowsPerChunk = 1 << 13;
constexpr int64_t kAhead = 8;  // rows between the fetch of one and its use: the order is not that of memory

// A search among 255 bounds in eight steps without branches.
class Codebook {
 public:
  explicit Codebook(const float* bounds) {
    for (int i = 0; i < 255; ++i) bounds_[i] = bounds[i];
  }

  uint8_t code(float value) const {
    int below = 0;
    for (int step = 128; step > 0; step >>= 1) below += bounds_[below + step - 1] < value ? step : 0;
    return uint8_t(below);
  }

 private:
  float bounds_[255];
};

double rounded_in(double value, double top) {
  const double rounded = std::nearbyint(value);
  return rounded < 0 ? 0 : rounded > top ? top : rounded;
}

void encode_quat(const float* quat, uint8_t* out) {
  double norm = 0;
  int largest = 0;
  for (int i = 0; i < 4; ++i) {
    norm += double(quat[i]) * quat[i];
    if (std::fabs(quat[i]) > std::fabs(quat[largest])) largest = i;
  }
  const double scale = std::copysign(std::sqrt(0.5 / norm), double(quat[largest]));  // q and −q are one rotation
  for (int i = 0, channel = 0; i < 4; ++i)
    if (i != largest) out[channel++] = uint8_t(rounded_in((quat[i] * scale + 0.5) * 255, 255));
  out[3] = uint8_t(252 + largest);
}

}  // namespace

void encode_sog(const SogEncodeJob& job, int threads) {
  const Codebook scale_codes(job.scale_bounds), dc_codes(job.dc_bounds);
  double low[3], steps[3];
  for (int axis = 0; axis < 3; ++axis) {
    const double spread = job.mean_ranges[3 + axis] - job.mean_ranges[axis];
    low[axis] = job.mean_ranges[axis];
    steps[axis] = 65535 / (spread > 0 ? spread : 1);
  }
  parallel_ranges(job.num_rows, kRowsPerChunk, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const int64_t row = job.order[i], later = job.order[i + kAhead < end ? i + kAhead : end - 1];
      __builtin_prefetch(job.means + 3 * later);
      __builtin_prefetch(job.quats + 4 * later);
      __builtin_prefetch(job.log_scales + 3 * later);
      __builtin_prefetch(job.logit_opacities + later);
      __builtin_prefetch(job.sh + job.sh_stride * later);
      for (int axis = 0; axis < 3; ++axis) {
        const double x = job.means[3 * row + axis];
        const double m = std::copysign(std::log1p(std::fabs(x)), x);
        const int u = int(rounded_in((m - low[axis]) * steps[axis], 65535));
        job.means_l[3 * i + axis] = uint8_t(u & 255);
        job.means_u[3 * i + axis] = uint8_t(u >> 8);
        job.scales[3 * i + axis] = scale_codes.code(job.log_scales[3 * row + axis]);
        job.sh0[4 * i + axis] = dc_codes.code(job.sh[job.sh_stride * row + axis]);
      }
      job.sh0[4 * i + 3] = uint8_t(std::nearbyint(255 / (1 + std::exp(-double(job.logit_opacities[row])))));
      encode_quat(job.quats + 4 * row, job.quats_pixels + 4 * i);
    }
  });
}

void find_codes(const float* values, int64_t count, const float* bounds, uint8_t* out, int threads) {
  const Codebook codebook(bounds);
  parallel_ranges(count, 1 << 16, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) out[i] = codebook.code(values[i]);
  });
}

}  // namespace splatree
