#include "cpu/codec/sog.h"

#include <atomic>
#include <cmath>
#include <limits>

#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

constexpr int64_t ROWS_PER_CHUNK = 1 << 13;
constexpr int64_t AHEAD = 8;  // rows between the fetch of an entry of the palette and its use

// The number of bounds below a value. The bounds' range is cut into cells; a value's cell is found by one product, which keeps
// order, so only the bounds of its own cell are left to search.
class Codebook {
 public:
  explicit Codebook(const float* bounds) : bounds_(bounds), low_(bounds[0]) {
    const float range = bounds[BOUNDS - 1] - low_;
    scale_ = range > 0 && range < std::numeric_limits<float>::infinity() ? CELLS / range : 0;
    for (int cell = 0, i = 0; cell <= CELLS; ++cell) {
      while (i < BOUNDS && cell_of(bounds[i]) < cell) ++i;
      first_[cell] = uint8_t(i);
    }
    first_[CELLS + 1] = BOUNDS;
  }

  uint8_t code(float value) const {
    const int cell = cell_of(value);
    int low = first_[cell], high = first_[cell + 1];
    while (low < high) {
      const int middle = (low + high) / 2;
      if (bounds_[middle] < value)
        low = middle + 1;
      else
        high = middle;
    }
    return uint8_t(low);
  }

 private:
  static constexpr int BOUNDS = 255, CELLS = 2048;

  int cell_of(float value) const {
    const float cell = (value - low_) * scale_;
    return cell > 0 ? cell < CELLS ? int(cell) : CELLS : 0;
  }

  const float* bounds_;
  float low_, scale_;
  uint8_t first_[CELLS + 2];  // bounds in the cells before
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

// The least of the rows that threads find, or -1.
class FirstRow {
 public:
  void found(int64_t row) {
    int64_t least = row_.load();
    while (row < least && !row_.compare_exchange_weak(least, row)) {
    }
  }
  int64_t get() const { return row_ == NONE ? -1 : row_.load(); }

 private:
  static constexpr int64_t NONE = std::numeric_limits<int64_t>::max();
  std::atomic<int64_t> row_{NONE};
};

// The three smaller components of a quaternion, byte by byte.
class SmallComponents {
 public:
  SmallComponents() {
    for (int i = 0; i < 256; ++i) values_[i] = (i / 255.0 * 2 - 1) / std::sqrt(2.0);
  }
  double operator[](uint8_t code) const { return values_[code]; }

 private:
  double values_[256];
};

bool decode_quat(const uint8_t* pixel, const SmallComponents& values, float* quat) {
  const int largest = int(pixel[3]) - 252;
  if (largest < 0) {
    quat[0] = quat[1] = quat[2] = quat[3] = 0;
    return false;
  }
  const double a = values[pixel[0]], b = values[pixel[1]], c = values[pixel[2]];
  const double rest = 1 - (a * a + b * b + c * c);
  quat[0] = float(a);  // each place but that of the largest: the others in their order
  quat[1] = float(largest == 0 ? a : b);
  quat[2] = float(largest <= 1 ? b : c);
  quat[3] = float(c);
  quat[largest] = float(std::sqrt(rest > 0 ? rest : 0));
  return true;
}

int64_t label_of(const SogDecodeJob& job, int64_t row) { return job.labels[3 * row] | job.labels[3 * row + 1] << 8; }

}  // namespace

void encode_sog(const SogEncodeJob& job, int threads) {
  const Codebook scale_codes(job.scale_bounds), dc_codes(job.dc_bounds);
  double low[3], steps[3];
  for (int axis = 0; axis < 3; ++axis) {
    const double spread = job.mean_ranges[3 + axis] - job.mean_ranges[axis];
    low[axis] = job.mean_ranges[axis];
    steps[axis] = 65535 / (spread > 0 ? spread : 1);
  }
  parallel_ranges(job.num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row) {
      const int64_t i = job.places[row];
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
      if (job.labels == nullptr) continue;
      job.labels_pixels[3 * i] = uint8_t(job.labels[row] & 255);
      job.labels_pixels[3 * i + 1] = uint8_t(job.labels[row] >> 8);
    }
  });
}

SogDamage decode_sog(const SogDecodeJob& job, int threads) {
  const SmallComponents components;
  const int64_t num_rest = job.sh_stride - 3;
  FirstRow wrong_tag, wrong_label;
  parallel_ranges(job.num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      float* sh = job.sh + job.sh_stride * i;
      for (int axis = 0; axis < 3; ++axis) {
        const int u = job.means_l[3 * i + axis] | job.means_u[3 * i + axis] << 8;
        job.means[3 * i + axis] = job.mean_tables[axis << 16 | u];
        job.log_scales[3 * i + axis] = job.scale_tables[axis << 8 | job.scales[3 * i + axis]];
        sh[axis] = job.dc_tables[axis << 8 | job.sh0[4 * i + axis]];
      }
      job.logit_opacities[i] = job.logit_table[job.sh0[4 * i + 3]];
      if (!decode_quat(job.quats_pixels + 4 * i, components, job.quats + 4 * i)) wrong_tag.found(i);
      if (num_rest == 0) continue;
      const int64_t ahead = i + AHEAD < end ? i + AHEAD : end - 1;
      __builtin_prefetch(job.palette + num_rest * label_of(job, ahead));
      const int64_t label = label_of(job, i);
      if (label < job.palette_size) {
        const uint8_t* codes = job.palette + num_rest * label;
        for (int64_t j = 0; j < num_rest; ++j) sh[3 + j] = job.rest_table[codes[j]];
      } else {
        for (int64_t j = 0; j < num_rest; ++j) sh[3 + j] = 0;
        wrong_label.found(i);
      }
    }
  });
  return {wrong_tag.get(), wrong_label.get()};
}

void find_codes(const float* values, int64_t count, const float* bounds, uint8_t* out, int threads) {
  const Codebook codebook(bounds);
  parallel_ranges(count, 1 << 16, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) out[i] = codebook.code(values[i]);
  });
}

}  // namespace splatree
