// The binning as a whole (bin.cpp).
#pragma once
#include "cpu/frame/bin.h"
#include "cpu/runtime/scratch.h"

namespace splatree {

// Fills tile_start (t + 1) and returns the splats of all tiles.
Scratch<int32_t> bin(const BinJob& job, int64_t* tile_start);

}  // namespace splatree
