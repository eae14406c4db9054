#include <cmath>
#include <cstring>
#include <vector>

#include "cpu/codec/splat.h"
#include "cpu/runtime/files.h"
#include "cpu/runtime/scratch.h"
#include "shared/constants.h"

namespace splatree {

SplatTables splat_tables() {
  constexpr double OPACITY_MIN = 1e-6f;  // codes 0 and 255 have no logit and are read as this far from 0 and 1
  constexpr float C0 = float(constants::SH_C0);
  SplatTables tables;
  for (int i = 0; i < 256; ++i) {
    const double share = std::fmin(std::fmax(i / 255., OPACITY_MIN), 1 - OPACITY_MIN);
    tables.logits[i] = static_cast<float>(std::log(share / (1 - share)));
    tables.colors[i] = static_cast<float>((i / 255. - 0.5) / double(C0));
  }
  return tables;
}

void place_splats(const uint8_t* records, const uint16_t* ranks, int64_t num_rows, int64_t* places, int file) {
  std::vector<int64_t> ends(SPLAT_RANKS + 1);  // of each rank among these rows
  for (int64_t row = 0; row < num_rows; ++row) ++ends[ranks[row] + 1];
  for (int rank = 0; rank < SPLAT_RANKS; ++rank) ends[rank + 1] += ends[rank];

  const Scratch<uint8_t> in_order = allocate<uint8_t>(num_rows * SPLAT_BYTES);
  for (int64_t row = 0; row < num_rows; ++row)
    std::memcpy(in_order.get() + SPLAT_BYTES * ends[ranks[row]]++, records + SPLAT_BYTES * row, SPLAT_BYTES);

  int64_t begin = 0;
  for (int rank = 0; rank < SPLAT_RANKS; ++rank) {
    const int64_t count = ends[rank] - begin;
    if (count > 0) write_at(file, in_order.get() + SPLAT_BYTES * begin, SPLAT_BYTES * count, SPLAT_BYTES * places[rank]);
    places[rank] += count;
    begin = ends[rank];
  }
}

}  // namespace splatree
