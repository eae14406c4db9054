#include "cpu/machine/simulate.h"

#include <string>

#include "cpu/machine/back.h"
#include "cpu/machine/front.h"

namespace splatree::machine {
namespace {

constexpr int64_t PATIENCE = 1 << 20;  // cycles in which nothing moves
const char* const UNIT_NAMES[NUM_UNITS] = {"identification", "selection", "step 1", "step 2", "distribution", "sort", "blend"};

std::string state_of(const Result& result, const Dram& dram, int64_t now) {
  static const char* const streams[NUM_STREAMS] = {"records", "levels",    "geometry", "color", "lists",
                                                   "splats",  "projected", "pairs",    "frame"};
  std::string text = "cycle " + std::to_string(now);
  for (int i = 0; i < NUM_UNITS; ++i)
    text += std::string("; ") + UNIT_NAMES[i] + " has done " + std::to_string(result.units[i].items);
  for (int i = 0; i < NUM_STREAMS; ++i)
    text += std::string("; ") + streams[i] + " " + std::to_string(dram.arrived(Stream(i))) + " of " +
            std::to_string(dram.asked(Stream(i))) + " lines";
  return text;
}

}  // namespace

Result simulate(const Settings& settings, const Clusters& clusters, const Tiles& tiles) {
  Result result;
  Dram dram(settings.dram);
  Front front(settings, clusters, dram, result);
  Back back(settings, tiles, dram, result);
  bool front_done = false;
  int64_t still_since = 0, now = 0, served = 0;
  for (;; ++now) {
    dram.step(now);
    bool moved = dram.num_served != served;
    served = dram.num_served;
    if (!front_done) {
      moved |= front.step(now);
      front_done = front.is_done();
      if (front_done) result.front_cycles = now;
    }
    if (front_done || settings.overlaps) moved |= back.step(now);
    if (front_done && back.is_done()) break;
    if (moved) still_since = now;
    if (now - still_since > PATIENCE) {
      result.deadlock = state_of(result, dram, now);
      break;
    }
  }
  result.cycles = now;
  for (int i = 0; i < NUM_STREAMS; ++i) result.lines[i] = dram.asked(Stream(i));
  result.dram_busy = dram.busy_cycles, result.activations = dram.num_activations, result.row_hits = dram.num_row_hits;
  return result;
}

}  // namespace splatree::machine
