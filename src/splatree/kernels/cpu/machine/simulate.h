// The accelerator of Jo 2024 (§4) stepped cycle by cycle, over counts of rows and bytes: identification of clusters (CIE), the
// engines of step 1 and of step 2 with their ping-pong buffers, distribution to tiles, and the back end that sorts and blends
// tile by tile. All of them share one DRAM. `splatree/hardware` says what each number means.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "cpu/machine/dram.h"

namespace splatree::machine {

struct EngineSettings {
  double lanes;             // rows a cycle
  int latency, capacity;    // rows of one half of the buffer
  int halves;               // 2: ping-pong, 1: one buffer
  int64_t row_bytes, base;  // of a row in DRAM; where the column begins
};

struct Settings {
  DramSettings dram;
  // Step 0; no identification: every cluster is a run of rows that is read.
  bool identifies;
  int interval, latency, record_fifo, selected_fifo;
  int64_t record_bytes;
  bool selects_levels;  // whether kept clusters are walked for the nodes of a cut before step 1
  EngineSettings levels, geometry, color;
  double streamed_share;  // of survivors in a cluster from which its whole run of colours is read
  int64_t splat_bytes, pair_bytes;
  double pairs_per_cycle;
  int64_t pair_backlog;  // pairs that wait for distribution at most
  double list_lines_per_pair;
  // Back end.
  int renderers, lanes, sort_latency, blend_latency, tiles_waiting;
  bool overlaps;  // the back end of the frame before works beside the front end
};

// What the CIE visits, in order.
struct Clusters {
  const int32_t* visits;  // cluster, or -1 for one that is dropped
  int64_t num_visits;
  // Of each cluster: its rows in DRAM, those of them that step 1 reads, and what these become.
  const int64_t *first_row, *span_rows, *rows, *survivors, *pairs;
  const int64_t *walked, *walk_lines;  // rows that the walk looks at, and lines that these lie in
};

// Tiles in the order in which they are drawn.
struct Tiles {
  const int64_t *list_lines, *sort_cycles, *projected_lines, *blend_cycles, *frame_lines;
  int64_t count;
};

enum Unit { CIE, SELECTION, STEP1, STEP2, DISTRIBUTION, SORT, BLEND, NUM_UNITS };

struct UnitTime {
  int64_t busy = 0, stalled_on_input = 0, stalled_on_output = 0, idle = 0, first_start = -1, last_end = 0, items = 0;
};

struct FifoStatistics {
  int64_t pushes = 0, pops = 0, occupancy = 0, waited = 0, most = 0;
};

struct Span {
  int32_t unit;
  int64_t begin, end, items;
};

struct Result {
  int64_t front_cycles = 0, cycles = 0;
  UnitTime units[NUM_UNITS];
  FifoStatistics records, selected;
  int64_t lines[NUM_STREAMS] = {}, dram_busy = 0, activations = 0, row_hits = 0;
  int64_t rows_in = 0, survivors_out = 0, pairs_out = 0, tiles_out = 0;
  std::vector<Span> spans;
  std::string deadlock;  // empty, or the state in which nothing moved any more
};

Result simulate(const Settings& settings, const Clusters& clusters, const Tiles& tiles);

}  // namespace splatree::machine
