// Blending of the tiles' lists front to back; kernels/reference/blend.py is the definition.
//
// All three kernels draw the same picture, a thread a pixel, and so do all orders of the tiles; which is faster depends on the
// device and the view (kernels/cuda/renderer.py measures):
//
// blend_16    256 threads a tile of 16 × 16 px. A warp has 8 × 4 px.
// blend_8     64 threads a quarter of a tile, 8 × 8 px: more, smaller thread blocks that end sooner; a splat of the list that
//             misses the quarter is left out while it is loaded.
// blend_8x4   a warp an eighth of a tile: nobody waits for another warp, and a long list is split over most multiprocessors, but
//             is read eight times. Splitting it by its splats instead would change the order in which light is multiplied.
//
// Thread blocks take the tiles row by row, or those with the longest lists first (bin.cu): a device is then not left with a few
// long lists when all others are done.
//
// Each is there once more for splats that are tapered off, and blend_16 for what is wanted beside the picture: pixels_16 for
// outputs of pixels, pairs_16 for the sums of what each pair contributes, both_16 for both.
//
// The list is taken in batches: each thread loads a splat into shared memory. Then each warp tests 32 splats of the batch at
// once, a splat a lane, against its own 8 × 4 px, and evaluates those that may touch them, nearest first. Bounds are widened by
// what float32 may lose, so the test changes no pixel.
//
// The transmittance of a finished pixel is kept with a minus sign, so one comparison tells that it takes no more light.
#include "cuda/tile.h"
#include "shared/blend.h"

namespace splatree {
namespace {

constexpr float TAPER_SLOPE = float(constants::TAPER_SLOPE);

struct Pixel {
  float transmittance, red, green, blue, depth;
};

// What is kept of a pixel beside the picture; entries of the tile's list count from 1.
struct Kept {
  int last;      // last entry that was blended, 0 if none
  int finisher;  // entry that finished the pixel, 0 if none did
  float median;  // depth at which the transmittance fell below ½
};

// Draws a splat, an entry of the list, at a pixel; returns α T, 0 where it is not drawn.
template <class Ends, class Keeps>
SPLATREE_FN float draw(Pixel& pixel, Kept& kept, int entry, float log2_alpha, float4 color, float log2_threshold, float floor) {
  const float whole = exp2_of(log2_alpha);
  const bool passes = Ends::TAPERS ? whole >= floor : log2_alpha >= log2_threshold;
  if (!(passes && pixel.transmittance > 0.f)) return 0.f;
  const float left = Ends::TAPERS ? least(TAPER_SLOPE * (whole - floor) + ALPHA_THRESHOLD, whole) : whole;
  const float alpha = least(left, ALPHA_MAX);
  const float after = pixel.transmittance * (1.f - alpha);
  if (after < TRANSMITTANCE_MIN) {
    pixel.transmittance = -pixel.transmittance;
    if (Keeps::OF_PIXELS) kept.finisher = entry;
    return 0.f;
  }
  if (Keeps::OF_PIXELS) {
    kept.last = entry;
    if (pixel.transmittance >= HALF_TRANSMITTANCE && after < HALF_TRANSMITTANCE) kept.median = color.w;
  }
  const float weight = pixel.transmittance * alpha;
  pixel.red += weight * color.x;
  pixel.green += weight * color.y;
  pixel.blue += weight * color.z;
  pixel.depth += weight * color.w;
  pixel.transmittance = after;
  return weight;
}

// WIDTH × HEIGHT px a thread block: a tile or an equal part of it.
template <int WIDTH, int HEIGHT, class Ends, class Keeps>
SPLATREE_FN void blend(const FrameJob* job, int packed) {
  constexpr int THREADS = WIDTH * HEIGHT, ACROSS = int(TILE_PX) / WIDTH, PARTS = ACROSS * (int(TILE_PX) / HEIGHT);
  constexpr bool TAPER = Ends::TAPERS, CONTRIBUTIONS = Keeps::OF_PAIRS;
  static_assert(PARTS == 1 || !(Keeps::OF_PIXELS || Keeps::OF_PAIRS),
                "entries are known where no splat is left out while it is loaded");
  SPLATREE_SHARED(float4, geometry, THREADS);    // x, y, a, b
  SPLATREE_SHARED(float4, appearance, THREADS);  // c, log2 opacity, half size x, half size y
  SPLATREE_SHARED(float4, color, THREADS);       // red, green, blue, depth
  SPLATREE_SHARED(float, floors, TAPER ? THREADS : 1);
  SPLATREE_SHARED(int, num_loaded, THREADS / WARP);
  SPLATREE_SHARED(float, sums, CONTRIBUTIONS ? THREADS*(THREADS / WARP) : 1);  // of each warp and splat

  const FrameNumbers& n = job->numbers;
  const bool from_b = packed & 1, longest_first = packed >> 1;
  const Global<const unsigned> pairs = from_b ? job->values_b : job->values_a;
  const int nth = blockIdx.x / PARTS, part = blockIdx.x % PARTS;
  const int tile = longest_first ? int(job->tile_order[nth]) : nth;
  const float part_x = TILE_PX * (tile % n.num_tiles_x) + WIDTH * (part % ACROSS);
  const float part_y = TILE_PX * (tile / n.num_tiles_x) + HEIGHT * (part / ACROSS);
  const float warp_x = part_x + WARP_WIDTH * (warp_of() % (WIDTH / WARP_WIDTH));
  const float warp_y = part_y + WARP_HEIGHT * (warp_of() / (WIDTH / WARP_WIDTH));
  const int x = int(warp_x) + lane_of() % WARP_WIDTH, y = int(warp_y) + lane_of() / WARP_WIDTH;
  const bool in_image = x < n.width && y < n.height;
  const float threshold = n.log2_pixel_threshold;

  Pixel pixel = {in_image ? 1.f : -1.f, 0, 0, 0, 0};
  Kept kept = {0, 0, 0};
  const long long begin = job->tile_start[tile], end = job->tile_start[tile + 1];
  long long at = begin;
  unsigned num_evaluated = 0, num_blended = 0;
  while (at < end) {
    if (!__syncthreads_or(pixel.transmittance > 0.f)) break;
    // A batch. In a part of a tile those that miss it are left out, the others keep their order.
    const bool there = at + threadIdx.x < end;
    Brush brush = {};
    float floor = 0, ends = threshold;
    bool taken = there;
    if (there) {
      const long long splat = pairs[at + threadIdx.x];
      brush = load_brush(job, splat);
      if (TAPER) floor = job->floors[splat], ends = log2_of(floor);
      if (PARTS > 1)
        taken = may_touch(brush.geometry, brush.appearance, part_x + 0.5f * WIDTH, part_y + 0.5f * HEIGHT, 0.5f * (WIDTH - 1),
                          0.5f * (HEIGHT - 1), ends);
    }
    const unsigned lanes = __ballot_sync(ALL_LANES, taken);
    if (lane_of() == 0) num_loaded[warp_of()] = __popc(lanes);
    __syncthreads();
    int place = __popc(lanes & lanes_before()), loaded = 0;
    for (int warp = 0; warp < THREADS / WARP; ++warp) {
      if (warp < warp_of()) place += num_loaded[warp];
      loaded += num_loaded[warp];
    }
    if (taken) {
      geometry[place] = brush.geometry;
      appearance[place] = brush.appearance;
      color[place] = brush.color;
      if (TAPER) floors[place] = floor;
    }
    if (CONTRIBUTIONS)
      for (int warp = 0; warp < THREADS / WARP; ++warp) sums[warp * THREADS + threadIdx.x] = 0;
    __syncthreads();
    const long long first_pair = at;
    at = at + THREADS < end ? at + THREADS : end;

    for (int first = 0; first < loaded; first += WARP) {
      if (!__any_sync(ALL_LANES, pixel.transmittance > 0.f)) break;
      const int mine = first + lane_of();
      bool touches = mine < loaded;
      if (touches && THREADS > WARP)  // a warp alone has tested them while it loaded them
        touches = may_touch_warp(geometry[mine], appearance[mine], warp_x, warp_y, TAPER ? log2_of(floors[mine]) : threshold);
      for (unsigned left = __ballot_sync(ALL_LANES, touches); left; left &= left - 1) {
        const int splat = first + __ffs(left) - 1;
        const float4 g = geometry[splat], a = appearance[splat];
        const float dx = x + 0.5f - g.x, dy = y + 0.5f - g.y;
        const float u = g.z * dx + g.w * dy, v = a.x * dy;
        const int entry = int(first_pair - begin) + splat + 1;
        const float weight =
            draw<Ends, Keeps>(pixel, kept, entry, a.y - (u * u + v * v), color[splat], threshold, TAPER ? floors[splat] : 0.f);
        num_evaluated += WARP;
        num_blended += weight > 0.f;
        if (CONTRIBUTIONS) {
          const float sum = sum_of_warp(weight);
          if (lane_of() == 0) sums[warp_of() * THREADS + splat] = sum;
        }
      }
    }
    if (CONTRIBUTIONS) {
      // Warp by warp, so that the sum does not depend on which of them was first. Here a splat's place is its thread's.
      __syncthreads();
      float sum = 0;
      for (int warp = 0; warp < THREADS / WARP; ++warp) sum += sums[warp * THREADS + threadIdx.x];
      if (there) job->contributions[first_pair + threadIdx.x] = sum;
    }
  }

  unsigned blended_of_warp;
  sum_before(num_blended, blended_of_warp);
  unsigned num_consumed = unsigned(at - begin);
  if (Keeps::OF_PIXELS) {
    // By the definition: a pixel reads the entries up to the one that finishes it.
    const int read = !in_image ? 0 : kept.finisher ? kept.finisher : int(end - begin);
    num_evaluated = sum_of_warp(read), num_consumed = largest_of_warp(read);
  }
  if (lane_of() == 0) {
    if (Keeps::OF_PIXELS || threadIdx.x == 0) atomicMax(&job->tile_work[3 * tile], (unsigned long long)num_consumed);
    if (num_evaluated) atomicAdd(&job->tile_work[3 * tile + 1], (unsigned long long)num_evaluated);
    if (blended_of_warp) atomicAdd(&job->tile_work[3 * tile + 2], (unsigned long long)blended_of_warp);
  }
  if (!in_image) return;
  const long long to = (long long)y * n.width + x;
  const float left = __builtin_fabsf(pixel.transmittance), stopped = 1.f - left;
  job->image[3 * to] = pixel.red + left * n.background[0];
  job->image[3 * to + 1] = pixel.green + left * n.background[1];
  job->image[3 * to + 2] = pixel.blue + left * n.background[2];
  job->alpha[to] = stopped;
  job->depth[to] = stopped > 0.f ? pixel.depth / stopped : 0.f;
  if (Keeps::OF_PIXELS) {
    job->last_pair[to] = kept.last ? int(begin) + kept.last - 1 : -1;
    job->median_depth[to] = kept.median;
  }
}

}  // namespace
}  // namespace splatree

using namespace splatree;

// Packed: the side on which the sort of the pairs ended; whether tiles with long lists come first.
SPLATREE_KERNEL(256, 1) blend_16(const FrameJob* job, int packed) { blend<16, 16, Hard, PictureAlone>(job, packed); }
SPLATREE_KERNEL(64, 1) blend_8(const FrameJob* job, int packed) { blend<8, 8, Hard, PictureAlone>(job, packed); }
SPLATREE_KERNEL(32, 1) blend_8x4(const FrameJob* job, int packed) { blend<8, 4, Hard, PictureAlone>(job, packed); }
SPLATREE_KERNEL(256, 1) taper_16(const FrameJob* job, int packed) { blend<16, 16, Taper, PictureAlone>(job, packed); }
SPLATREE_KERNEL(64, 1) taper_8(const FrameJob* job, int packed) { blend<8, 8, Taper, PictureAlone>(job, packed); }
SPLATREE_KERNEL(32, 1) taper_8x4(const FrameJob* job, int packed) { blend<8, 4, Taper, PictureAlone>(job, packed); }
SPLATREE_KERNEL(256, 1) pixels_16(const FrameJob* job, int packed) { blend<16, 16, Hard, AndPixels>(job, packed); }
SPLATREE_KERNEL(256, 1) pixels_taper_16(const FrameJob* job, int packed) { blend<16, 16, Taper, AndPixels>(job, packed); }
SPLATREE_KERNEL(256, 1) pairs_16(const FrameJob* job, int packed) { blend<16, 16, Hard, AndPairs>(job, packed); }
SPLATREE_KERNEL(256, 1) pairs_taper_16(const FrameJob* job, int packed) { blend<16, 16, Taper, AndPairs>(job, packed); }
SPLATREE_KERNEL(256, 1) both_16(const FrameJob* job, int packed) { blend<16, 16, Hard, AndBoth>(job, packed); }
SPLATREE_KERNEL(256, 1) both_taper_16(const FrameJob* job, int packed) { blend<16, 16, Taper, AndBoth>(job, packed); }
