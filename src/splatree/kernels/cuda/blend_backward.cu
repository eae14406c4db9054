// Backward over the pixels of the tiles; kernels/reference/backward.py is the definition, kernels/cpu/frame/blend_backward.cpp
// the same on the processor.
//
// blend_backward   256 threads a tile, a thread a pixel, a warp 8 × 4 px: the list front to back as it was drawn, 32 pairs at a
//                  time. A warp leaves out the splats that miss its pixels. It adds up the sums of the others over its lanes;
//                  then the sums of the eight warps are added in their order, and go to the pair's own place.
// key_by_splat     a thread a pair: pairs with their splats as keys, to be sorted (order.cu)
// sum_splats       16 threads a splat, a thread a sum: the sums of its pairs, in the order of the tiles
//
// No sum depends on which thread block was first, so two runs give the same bits. Of the forward pass nothing is stored but the
// picture: behind each splat there is the light R that is still to come, from which each takes its own share away.
#include "cuda/tile.h"
#include "shared/sums.h"

namespace splatree {
namespace {

constexpr int THREADS = 256, WARPS = THREADS / WARP, SUM_THREADS = 16;
static_assert(NUM_SUMS <= SUM_THREADS, "a warp adds up 16 sums at once");

// A pixel on the way through its list.
struct Ray {
  float transmittance;            // with a minus sign where the pixel is finished
  float behind;                   // R
  float red, green, blue, depth;  // ∂loss/∂C, ∂loss/∂(Σ w z)
  float error;
};

SPLATREE_FN Ray load_ray(const FrameJob* job, int x, int y) {
  Ray ray = {-1.f, 0, 0, 0, 0, 0, 0};
  if (x >= job->numbers.width || y >= job->numbers.height) return ray;
  const long long pixel = (long long)y * job->numbers.width + x;
  ray.transmittance = 1.f;
  ray.red = job->by_image[3 * pixel], ray.green = job->by_image[3 * pixel + 1], ray.blue = job->by_image[3 * pixel + 2];
  ray.error = job->pixel_errors[pixel];
  float light = ray.red * job->image[3 * pixel] + ray.green * job->image[3 * pixel + 1] + ray.blue * job->image[3 * pixel + 2];
  float by_alpha = job->by_alpha[pixel];
  const float alpha = job->alpha[pixel];
  if (alpha > 0.f) {  // depth = (Σ w z) / alpha
    const float by_depth = job->by_depth[pixel], depth = job->depth[pixel];
    ray.depth = by_depth / alpha;
    by_alpha -= ray.depth * depth;
    light += by_depth * depth;
  }
  ray.behind = light - (1.f - alpha) * by_alpha;
  return ray;
}

// What a splat gives at a pixel, in the order of SplatSum; returns whether the pixel had light left for it.
SPLATREE_FN bool draw_backward(Ray& ray, float u, float v, float log2_opacity, const float4& color, float log2_threshold,
                               float (&sums)[16]) {
  // As `draw` in blend.cu.
  const float log2_alpha = log2_opacity - (u * u + v * v);
  const float whole = exp2_of(log2_alpha), alpha = least(whole, ALPHA_MAX), before = ray.transmittance;
  const float after = before * (1.f - alpha);
  const bool seen = log2_alpha >= log2_threshold && before > 0.f, drawn = seen && after >= TRANSMITTANCE_MIN;
  const float weight = drawn ? before * alpha : 0.f;
  ray.transmittance = drawn ? after : seen ? -before : before;

  const float light = weight * (ray.red * color.x + ray.green * color.y + ray.blue * color.z + ray.depth * color.w);
  ray.behind -= light;
  const float h = drawn && whole <= ALPHA_MAX ? light - ray.behind * alpha / (1.f - alpha) : 0.f;
  sums[SUM_H] = h, sums[SUM_HU] = h * u, sums[SUM_HV] = h * v;
  sums[SUM_HUU] = h * u * u, sums[SUM_HUV] = h * u * v, sums[SUM_HVV] = h * v * v;
  sums[SUM_RED] = weight * ray.red, sums[SUM_GREEN] = weight * ray.green, sums[SUM_BLUE] = weight * ray.blue;
  sums[SUM_DEPTH] = weight * ray.depth, sums[SUM_WEIGHT] = weight, sums[SUM_ERROR] = weight * ray.error;
  for (int k = NUM_SUMS; k < 16; ++k) sums[k] = 0.f;
  return seen;
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(256, 4) blend_backward(const FrameJob* job, int from_b) {
  SPLATREE_SHARED(float4, geometry, WARP);
  SPLATREE_SHARED(float4, appearance, WARP);
  SPLATREE_SHARED(float4, color, WARP);
  SPLATREE_SHARED(float, sums, WARPS* WARP* NUM_SUMS);  // of each warp and splat
  SPLATREE_SHARED(unsigned, drawn_by, WARPS);           // the splats of which a warp has sums

  const FrameNumbers& n = job->numbers;
  const Global<const unsigned> pairs = from_b ? job->values_b : job->values_a;
  const int tile = blockIdx.x, warp = warp_of();
  const float warp_x = TILE_PX * (tile % n.num_tiles_x) + WARP_WIDTH * (warp % 2);
  const float warp_y = TILE_PX * (tile / n.num_tiles_x) + WARP_HEIGHT * (warp / 2);
  const int x = int(warp_x) + lane_of() % WARP_WIDTH, y = int(warp_y) + lane_of() / WARP_WIDTH;
  Ray ray = load_ray(job, x, y);
  const long long begin = job->tile_start[tile], end = job->tile_start[tile + 1];
  long long at = begin;
  for (; at < end; at += WARP) {
    if (!__syncthreads_or(ray.transmittance > 0.f)) break;
    const int loaded = end - at < WARP ? int(end - at) : WARP;
    if ((int)threadIdx.x < loaded) {
      const Brush brush = load_brush(job, pairs[at + threadIdx.x]);
      geometry[threadIdx.x] = brush.geometry, appearance[threadIdx.x] = brush.appearance, color[threadIdx.x] = brush.color;
    }
    __syncthreads();
    unsigned drawn = 0;
    if (__any_sync(ALL_LANES, ray.transmittance > 0.f)) {
      const int mine = lane_of();
      const bool touches =
          mine < loaded && may_touch_warp(geometry[mine], appearance[mine], warp_x, warp_y, n.log2_pixel_threshold);
      for (unsigned left = __ballot_sync(ALL_LANES, touches); left; left &= left - 1) {
        const int splat = __ffs(left) - 1;
        const float4 g = geometry[splat], a = appearance[splat];
        const float dx = x + 0.5f - g.x, dy = y + 0.5f - g.y;
        float own[16];
        const bool seen = draw_backward(ray, g.z * dx + g.w * dy, a.x * dy, a.y, color[splat], n.log2_pixel_threshold, own);
        if (!__any_sync(ALL_LANES, seen)) continue;
        const float sum = sums_of_warp(own);
        const int k = lane_of() / 2;
        if (lane_of() % 2 == 0 && k < NUM_SUMS) sums[(warp * WARP + splat) * NUM_SUMS + k] = sum;
        drawn |= 1u << splat;
      }
    }
    if (lane_of() == 0) drawn_by[warp] = drawn;
    __syncthreads();
    for (int i = threadIdx.x; i < loaded * NUM_SUMS; i += THREADS) {
      float sum = 0.f;
      for (int w = 0; w < WARPS; ++w)
        if (drawn_by[w] >> i / NUM_SUMS & 1) sum += sums[w * WARP * NUM_SUMS + i];
      job->pair_sums[at * NUM_SUMS + i] = sum;
    }
  }
  // What no pixel had light left for.
  for (long long i = at * NUM_SUMS + threadIdx.x; i < end * NUM_SUMS; i += THREADS) job->pair_sums[i] = 0.f;
}

SPLATREE_KERNEL(256, 1) key_by_splat(const FrameJob* job, int from_b) {
  const long long i = index_of_thread();
  if (i >= held(job->counters[NUM_PAIRS], job->pair_capacity)) return;
  job->keys_a[i] = from_b ? job->values_b[i] : job->values_a[i];
  job->values_a[i] = (unsigned)i;
}

SPLATREE_KERNEL(256, 1) sum_splats(const FrameJob* job, int from_b) {
  const long long splat = index_of_thread() / SUM_THREADS, k = index_of_thread() % SUM_THREADS;
  if (splat >= held(job->counters[NUM_SELECTED], job->row_capacity) || k >= NUM_SUMS) return;
  const Global<unsigned> keys = from_b ? job->keys_b : job->keys_a, pairs = from_b ? job->values_b : job->values_a;
  const long long count = held(job->counters[NUM_PAIRS], job->pair_capacity);
  float sum = 0.f;
  for (long long at = place_of_key(keys, count, splat); at < count && keys[at] == splat; ++at)
    sum += job->pair_sums[(long long)pairs[at] * NUM_SUMS + k];
  job->splat_sums[splat * NUM_SUMS + k] = sum;
}
