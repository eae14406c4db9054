// Blending of a tile: splats outside, 16 lanes inside. A tile of 16 × 16 px is 16 cells of 4 × 4 px; a lane is a pixel
// of a cell. A splat first finds the cells that it touches (16 lanes, one a cell), then is evaluated in these. A cell
// is finished when all its pixels are; that is looked up every 32 splats.
//
// The transmittance of a finished pixel is kept with a minus sign, so one comparison tells that it takes no more light.
#include "cpu/frame/blend.h"

#include <string.h>

#include "cpu/frame/brush.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "shared/blend.h"
#include "shared/constants.h"
#include "shared/elementary.h"
#include "shared/record.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int GROUP = 8;  // pairs whose cells are found before the first of them is blended
constexpr int AHEAD = 8;  // pairs between the fetch of a record and its use
constexpr float TAPER_SLOPE = float(constants::TAPER_SLOPE), ALPHA_THRESHOLD = float(constants::ALPHA_THRESHOLD);

struct alignas(64) Tile {
  float transmittance[CELLS][LANES];
  float red[CELLS][LANES], green[CELLS][LANES], blue[CELLS][LANES], depth[CELLS][LANES];
  int32_t blended[LANES];
};

// What is kept of each pixel beside the picture; entries count from 1 at the start of the tile's list.
struct alignas(64) Pixels {
  int32_t last[CELLS][LANES];      // last entry that was blended, 0 if none
  int32_t finisher[CELLS][LANES];  // entry that finished the pixel, 0 if none did
  float median[CELLS][LANES];      // depth at which T fell below ½
};

// Notes which pixels an entry finished, or brought below half of the light; both happen once a pixel.
void note_turns(const float* before, const float* after, int32_t entry, float depth, int cell, Pixels& pixels) {
  for (int l = 0; l < LANES; ++l) {
    if (before[l] > 0.f && after[l] < 0.f) pixels.finisher[cell][l] = entry;
    if (before[l] >= HALF_TRANSMITTANCE && after[l] < HALF_TRANSMITTANCE && after[l] >= 0.f) pixels.median[cell][l] = depth;
  }
}

template <class Ends, class Keeps>
SPLATREE_FN void blend_cell(Brush& brush, int cell, const Limits& limits, int32_t entry, Tile& tile, Pixels& pixels) {
  const float u_of_cell = brush.u_of_cell[cell], v_of_cell = brush.v_of_cell[cell];
  float* transmittance = tile.transmittance[cell];
  float *red = tile.red[cell], *green = tile.green[cell], *blue = tile.blue[cell], *depth = tile.depth[cell];
  int32_t* last = pixels.last[cell];
  float light[LANES];  // transmittance before the splat
  int turned = 0;      // whether a pixel was finished, or lost half of its light
#pragma omp simd reduction(| : turned)
  for (int l = 0; l < LANES; ++l) {
    const float u = u_of_cell + brush.u_of_lane[l], v = v_of_cell + brush.v_of_lane[l];
    const float log2_alpha = brush.log2_opacity - (u * u + v * v);
    // Where it is not exact, far outside, the splat does not pass.
    const float whole = Ends::TAPERS ? exp2_of(log2_alpha) : exp2_within(log2_alpha);
    const float left = Ends::TAPERS ? least(TAPER_SLOPE * (whole - brush.floor) + ALPHA_THRESHOLD, whole) : whole;
    const float alpha = least(left, limits.alpha_max);
    const float before = transmittance[l];
    const float after = before * (1.f - alpha);
    const bool passes = Ends::TAPERS ? whole >= brush.floor : log2_alpha >= brush.log2_threshold;
    const bool seen = passes & (before > 0.f);
    const bool drawn = Keeps::OF_DEPTH ? seen & (after >= TRANSMITTANCE_MIN) : seen;
    const float weight = drawn ? before * alpha : 0.f;
    if (Keeps::OF_DEPTH)
      transmittance[l] = drawn ? after : seen ? -before : before;
    else
      transmittance[l] = seen ? (after >= limits.least_light ? after : -after) : before;
    red[l] += weight * brush.red;
    green[l] += weight * brush.green;
    blue[l] += weight * brush.blue;
    if (Keeps::OF_DEPTH) depth[l] += weight * brush.depth;
    tile.blended[l] += drawn ? 1 : 0;
    if (Keeps::OF_PAIRS) brush.contribution[l] += weight;
    if (Keeps::OF_PIXELS) {
      last[l] = drawn ? entry : last[l];
      light[l] = before;
      turned |= (seen & !drawn) | ((before >= HALF_TRANSMITTANCE) & (after < HALF_TRANSMITTANCE)) ? 1 : 0;
    }
  }
  if (Keeps::OF_PIXELS && turned) note_turns(light, transmittance, entry, brush.depth, cell, pixels);
}

int64_t smallest(int64_t a, int64_t b, int64_t c) {
  const int64_t ab = a < b ? a : b;
  return ab < c ? ab : c;
}

// The sum of the lanes, always in the same order.
float sum_of(const float (&lanes)[LANES]) {
  float halves[LANES / 2], sum = 0.f;
  for (int l = 0; l < LANES / 2; ++l) halves[l] = lanes[l] + lanes[l + LANES / 2];
  for (int l = 0; l < LANES / 2; ++l) sum += halves[l];
  return sum;
}

// The outputs beside the picture, and the exact counts of entries: a pixel reads those up to the one that finishes it.
void keep_pixels(const BlendJob& job, int64_t index, int x0, int y0, const Pixels& pixels) {
  const int64_t begin = job.tile_start[index];
  const int32_t length = int32_t(job.tile_start[index + 1] - begin);
  int64_t num_evaluated = 0, num_consumed = 0;
  for (int cell = 0; cell < CELLS; ++cell)
    for (int l = 0; l < LANES; ++l) {
      const int x = x0 + 4 * (cell & 3) + (l & 3), y = y0 + 4 * (cell >> 2) + (l >> 2);
      if (x >= job.width || y >= job.height) continue;
      const int64_t pixel = int64_t(y) * job.width + x;
      const int32_t last = pixels.last[cell][l], finisher = pixels.finisher[cell][l];
      if (job.last_pair) job.last_pair[pixel] = last ? begin + last - 1 : -1;
      if (job.median_depth) job.median_depth[pixel] = pixels.median[cell][l];
      const int32_t read = finisher ? finisher : length;
      num_evaluated += read;
      num_consumed = num_consumed < read ? read : num_consumed;
    }
  if (!job.last_pair) return;
  job.num_consumed[index] = num_consumed;
  job.num_evaluated[index] = num_evaluated;
}

template <class Ends, class Keeps>
void blend_tile(const BlendJob& job, int64_t index) {
  const int x0 = int(index % job.num_tiles_x) * TILE, y0 = int(index / job.num_tiles_x) * TILE;
  Tile tile;
  Pixels pixels;
  memset(&tile, 0, sizeof tile);
  if (Keeps::OF_PIXELS) memset(&pixels, 0, sizeof pixels);
  for (int cell = 0; cell < CELLS; ++cell)
    for (int l = 0; l < LANES; ++l) {
      const int x = x0 + 4 * (cell & 3) + (l & 3), y = y0 + 4 * (cell >> 2) + (l >> 2);
      tile.transmittance[cell][l] = x < job.width && y < job.height ? 1.f : -1.f;  // outside: finished
    }

  const int64_t begin = job.tile_start[index], end = job.tile_start[index + 1];
  int64_t num_evaluated = 0;
  int open = open_cells(tile.transmittance);
  Brush brushes[GROUP];
  const Limits limits = {unknown(ALPHA_MAX), unknown(0.f), job.least_light};
  int cells[GROUP];
  if (Keeps::OF_PAIRS && begin < end) memset(job.contributions + begin, 0, (end - begin) * sizeof(float));
  int64_t i = begin;
  while (i < end) {
    const int since_look = int((i - begin + 1) % PERIOD);
    if (since_look == 0) {
      open = open_cells(tile.transmittance);
      if (!open) break;
    }
    const int count = int(smallest(GROUP, PERIOD - since_look, end - i));
    // How many cells a pair has decides a branch that is mostly guessed wrongly; it costs less if they are known by then.
    for (int j = 0; j < count; ++j) {
      const int32_t splat = job.splat_from_pair[i + j];
      if (i + j + AHEAD < end) __builtin_prefetch(job.records + int64_t(job.splat_from_pair[i + j + AHEAD]) * NUM_COLUMNS);
      const float* record = job.records + int64_t(splat) * NUM_COLUMNS;
      Brush& brush = brushes[j];
      if (Ends::TAPERS) brush.floor = job.floors[splat];
      cells[j] = load_brush(record, x0, y0, Ends::TAPERS ? log2_of(brush.floor) : job.log2_threshold, limits, brush);
      if (job.whole_tile) cells[j] = (1 << CELLS) - 1;
    }
    for (int j = 0; j < count; ++j) {
      Brush& brush = brushes[j];
      if (Keeps::OF_PAIRS) memset(brush.contribution, 0, sizeof brush.contribution);
      for (int left = cells[j] & open; left; left &= left - 1) {
        blend_cell<Ends, Keeps>(brush, __builtin_ctz(left), limits, int32_t(i + j - begin) + 1, tile, pixels);
        num_evaluated += LANES;
      }
      if (Keeps::OF_PAIRS) job.contributions[i + j] = sum_of(brush.contribution);
    }
    i += count;
  }

  job.num_consumed[index] = i - begin;
  job.num_evaluated[index] = num_evaluated;
  int64_t num_blended = 0;
  for (int l = 0; l < LANES; ++l) num_blended += tile.blended[l];
  job.num_blended[index] = num_blended;
  for (int cell = 0; cell < CELLS; ++cell)
    for (int l = 0; l < LANES; ++l) {
      const int x = x0 + 4 * (cell & 3) + (l & 3), y = y0 + 4 * (cell >> 2) + (l >> 2);
      if (x >= job.width || y >= job.height) continue;
      const int64_t pixel = int64_t(y) * job.width + x;
      const float signed_left = tile.transmittance[cell][l];
      const float left = signed_left < 0 ? -signed_left : signed_left;
      const float alpha = 1.f - left;
      job.image[3 * pixel] = tile.red[cell][l] + left * job.background[0];
      job.image[3 * pixel + 1] = tile.green[cell][l] + left * job.background[1];
      job.image[3 * pixel + 2] = tile.blue[cell][l] + left * job.background[2];
      job.alpha[pixel] = alpha;
      if (Keeps::OF_DEPTH) job.depth[pixel] = alpha > 0.f ? tile.depth[cell][l] / alpha : 0.f;
    }
  if (Keeps::OF_PIXELS) keep_pixels(job, index, x0, y0, pixels);
}

template <class Ends, class Keeps>
void blend_all(const BlendJob& job) {
  parallel_chunks(int64_t(job.num_tiles_x) * job.num_tiles_y, job.threads,
                  [&](int64_t index) { blend_tile<Ends, Keeps>(job, index); });
}

template <class Ends>
void blend_keeping(const BlendJob& job) {
  const bool of_pixels = job.last_pair || job.median_depth;
  if (job.contributions)
    of_pixels ? blend_all<Ends, AndBoth>(job) : blend_all<Ends, AndPairs>(job);
  else
    of_pixels   ? blend_all<Ends, AndPixels>(job)
    : job.depth ? blend_all<Ends, PictureAlone>(job)
                : blend_all<Ends, ColorsAlone>(job);
}

}  // namespace

void blend(const BlendJob& job) { job.floors ? blend_keeping<Taper>(job) : blend_keeping<Hard>(job); }

}  // namespace splatree::SPLATREE_ISA
