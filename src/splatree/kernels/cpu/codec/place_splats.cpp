#include <cmath>
#include <cstring>
#include <vector>

#include "cpu/codec/splat.h"
#include "cpu/runtime/files.h"
#include "cpu/runtime/scratch.h"

namespace splatree {

SplatTables splat_tables() {
  constexpr double kOpacityMin = 1e-6f;  // codes 0 and 255 have no logit and are read as this far from 0 and 1
  constexpr float kC0 = 0.28209479177387814f;
  SplatTables tables;
  for (int i = 0; i < 256; ++i) {
    const double share = std::fmin(std::fmax(i / 255., kOpacityMin), 1 - kOpacityMin);
    tables.logits[i] = static_cast<float>(std::log(share / (1 - share)));
    tables.colors[i] = static_cast<float>((i / 255. - 0.5) / double(kC0));
  }
  return tables;
}

void place_splats(const uint8_t* records, const uint16_t* ranks, int64_t num_rows, int64_t* places, int file) {
  std::vector<int64_t> ends(kSplatRanks + 1);  // of each rank among these rows
  for (int64_t row = 0; row < num_rows; ++row) ++ends[ranks[row] + 1];
  for (int rank = 0; rank < kSplatRanks; ++rank) ends[rank + 1] += ends[rank];

  const Scratch<uint8_t> in_order = allocate<uint8_t>(num_rows * kSplatBytes);
  for (int64_t row = 0; row < num_rows; ++row)
    std::memcpy(in_order.get() + kSplatBytes * ends[ranks[row]]++, records + kSplatBytes * row, kSplatBytes);

  int64_t begin = 0;
  for (int rank = 0; rank < kSplatRanks; ++rank) {
    const int64_t count = ends[rank] - begin;
    if (count > 0) write_at(file, in_order.get() + kSplatBytes * begin, kSplatBytes * count, kSplatBytes * places[rank]);
    places[rank] += count;
    begin = ends[rank];
  }
}

}  // namespace splatree
