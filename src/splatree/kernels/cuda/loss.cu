// The loss against a photograph and its derivative; kernels/reference/loss.py is the definition.
//
// compare_photo   256 threads 16 × 16 px, channel by channel: the five blurs of X and Y, along the rows and then down, and what
// the
//                 index says of them: its sum, and its derivatives P, Q, R by three of the blurs
// slope_of_loss   the same thread blocks: the blurs of P, Q and R, the derivative by the picture, the other sums
//
// Sums are those of a thread block, in a fixed order; the host adds them up.
#include "cuda/loss.h"
#include "shared/portable.h"
#include "shared/sums.h"

namespace splatree {
namespace {

constexpr int SIDE = 16, THREADS = SIDE * SIDE, HALF = LOSS_TAPS / 2, WIDE = SIDE + 2 * HALF;

// A channel of the picture X, under its gain, and of the photograph Y; equal where masked, 0 beyond the picture.
struct Sample {
  float x, y, counts;
};

SPLATREE_FN Sample load_sample(const LossJob* job, long long x, long long y, int channel) {
  if (x < 0 || y < 0 || x >= job->width || y >= job->height) return {0.f, 0.f, 0.f};
  const long long pixel = y * job->width + x, at = 3 * pixel + channel;
  const float photo = float(job->photo[at]) * (1.f / 255.f);
  return job->mask[pixel] ? Sample{job->numbers[GAIN + channel] * job->image[at], photo, 1.f} : Sample{photo, photo, 0.f};
}

// The corner of a thread block's pixels.
struct Corner {
  long long x, y;
};

SPLATREE_FN Corner corner_of(const LossJob* job) {
  const long long blocks_x = (job->width + SIDE - 1) / SIDE;
  return {blockIdx.x % blocks_x * SIDE, blockIdx.x / blocks_x * SIDE};
}

// The sums over the threads of a thread block, in the order of LossSum: that of the index, or all others.
SPLATREE_FN void store_sums(const LossJob* job, float (&values)[16], bool of_index) {
  SPLATREE_SHARED(float, of_warps, THREADS / WARP * 16);
  const float sum = sums_of_warp(values);
  if (lane_of() % 2 == 0) of_warps[warp_of() * 16 + lane_of() / 2] = sum;
  __syncthreads();
  const int k = threadIdx.x;
  if (k >= NUM_LOSS_SUMS || (k == SUM_INDEX) != of_index) return;
  float total = 0.f;
  for (int warp = 0; warp < THREADS / WARP; ++warp) total += of_warps[warp * 16 + k];
  job->sums[(long long)blockIdx.x * NUM_LOSS_SUMS + k] = total;
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(256, 4) compare_photo(const LossJob* job) {
  SPLATREE_SHARED(float, picture, WIDE* WIDE);
  SPLATREE_SHARED(float, photo, WIDE* WIDE);
  SPLATREE_SHARED(float, along, 5 * WIDE * SIDE);  // blurred along the rows
  const Corner corner = corner_of(job);
  const int column = threadIdx.x % SIDE, row = threadIdx.x / SIDE;
  const long long x = corner.x + column, y = corner.y + row, size = 3 * job->width * job->height;
  const bool in_picture = x < job->width && y < job->height;
  float taps[LOSS_TAPS];
  for (int t = 0; t < LOSS_TAPS; ++t) taps[t] = job->numbers[TAP + t];
  const float c1 = job->numbers[C1], c2 = job->numbers[C2];
  float sums[16] = {};
  for (int channel = 0; channel < 3; ++channel) {
    __syncthreads();
    for (int i = threadIdx.x; i < WIDE * WIDE; i += THREADS) {
      const Sample s = load_sample(job, corner.x + i % WIDE - HALF, corner.y + i / WIDE - HALF, channel);
      picture[i] = s.x, photo[i] = s.y;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < WIDE * SIDE; i += THREADS) {
      float blurs[5] = {};
      for (int t = 0; t < LOSS_TAPS; ++t) {
        const int from = i / SIDE * WIDE + i % SIDE + t;
        const float a = picture[from], b = photo[from], wa = taps[t] * a, wb = taps[t] * b;
        blurs[0] += wa, blurs[1] += wb, blurs[2] += wa * a, blurs[3] += wb * b, blurs[4] += wa * b;
      }
      for (int m = 0; m < 5; ++m) along[m * WIDE * SIDE + i] = blurs[m];
    }
    __syncthreads();
    float blurs[5] = {};
    for (int t = 0; t < LOSS_TAPS; ++t)
      for (int m = 0; m < 5; ++m) blurs[m] += taps[t] * along[m * WIDE * SIDE + (row + t) * SIDE + column];
    if (!in_picture) continue;
    const float mx = blurs[0], my = blurs[1], both = mx * my, squares = mx * mx + my * my;
    const float a1 = 2.f * both + c1, a2 = 2.f * (blurs[4] - both) + c2;
    const float b1 = squares + c1, b2 = blurs[2] + blurs[3] - squares + c2;
    const float inverse = job->mask[y * job->width + x] ? 1.f / (b1 * b2) : 0.f, index = a1 * a2 * inverse;
    const long long at = 3 * (y * job->width + x) + channel;
    job->maps[at] = 2.f * (my * (a2 - a1) * inverse + mx * index * (1.f / b2 - 1.f / b1));
    job->maps[size + at] = -index / b2;
    job->maps[2 * size + at] = 2.f * a1 * inverse;
    sums[SUM_INDEX] += index;
  }
  store_sums(job, sums, true);
}

SPLATREE_KERNEL(256, 4) slope_of_loss(const LossJob* job) {
  SPLATREE_SHARED(float, maps, 3 * WIDE * WIDE);
  SPLATREE_SHARED(float, along, 3 * WIDE * SIDE);
  const Corner corner = corner_of(job);
  const int column = threadIdx.x % SIDE, row = threadIdx.x / SIDE;
  const long long x = corner.x + column, y = corner.y + row, size = 3 * job->width * job->height;
  const bool in_picture = x < job->width && y < job->height;
  float taps[LOSS_TAPS];
  for (int t = 0; t < LOSS_TAPS; ++t) taps[t] = job->numbers[TAP + t];
  float sums[16] = {};
#pragma unroll
  for (int channel = 0; channel < 3; ++channel) {
    __syncthreads();
    for (int i = threadIdx.x; i < WIDE * WIDE; i += THREADS) {
      const long long from_x = corner.x + i % WIDE - HALF, from_y = corner.y + i / WIDE - HALF;
      const bool there = from_x >= 0 && from_y >= 0 && from_x < job->width && from_y < job->height;
      const long long at = 3 * (from_y * job->width + from_x) + channel;
      for (int m = 0; m < 3; ++m) maps[m * WIDE * WIDE + i] = there ? float(job->maps[m * size + at]) : 0.f;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < WIDE * SIDE; i += THREADS)
      for (int m = 0; m < 3; ++m) {
        float blur = 0.f;
        for (int t = 0; t < LOSS_TAPS; ++t) blur += taps[t] * maps[m * WIDE * WIDE + i / SIDE * WIDE + i % SIDE + t];
        along[m * WIDE * SIDE + i] = blur;
      }
    __syncthreads();
    float blurs[3] = {};
    for (int t = 0; t < LOSS_TAPS; ++t)
      for (int m = 0; m < 3; ++m) blurs[m] += taps[t] * along[m * WIDE * SIDE + (row + t) * SIDE + column];
    if (!in_picture) continue;
    const Sample s = load_sample(job, x, y, channel);
    const float difference = s.x - s.y, sign = (difference > 0.f ? 1.f : 0.f) - (difference < 0.f ? 1.f : 0.f);
    const float by_index = job->numbers[BY_INDEX] * (blurs[0] + 2.f * s.x * blurs[1] + s.y * blurs[2]);
    const long long at = 3 * (y * job->width + x) + channel;
    const float bare = s.counts * job->image[at];
    job->by_image[at] = s.counts * job->numbers[GAIN + channel] * (job->numbers[BY_DIFFERENCE] * sign - by_index);
    sums[SUM_DIFFERENCE] += __builtin_fabsf(difference);
    sums[SUM_PRODUCT + channel] = bare * s.y, sums[SUM_SQUARE + channel] = bare * bare;
  }
  if (in_picture) job->errors[y * job->width + x] = sums[SUM_DIFFERENCE] * (1.f / 3.f);
  store_sums(job, sums, false);
}
