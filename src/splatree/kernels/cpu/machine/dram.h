// The accelerator's DRAM: streams that ask for lines in the order of time, and three models of when a line is served.
//
//   L0  a bus of so many bytes a cycle, and a fixed latency
//   L1  the same with refresh, turns between reading and writing, and the wait for a new row where a stream jumps and no other
//       stream has work; rows that follow each other lie in different banks and are opened ahead
//   L2  channels and banks: each bank has an open row, tRCD, tRP, tRAS, tRRD and tFAW hold, and of the lines in a window those
//       of open rows go first (FR-FCFS)
//
// A line that is read has arrived `latency` cycles after it was served; a line that is written is done when it was served.
#pragma once
#include <cstdint>
#include <deque>
#include <vector>

namespace splatree::machine {

enum Stream { RECORDS, LEVELS, GEOMETRY, COLOR, LISTS, SPLATS, PROJECTED, PAIRS, FRAME, NUM_STREAMS };
constexpr bool IS_WRITE[NUM_STREAMS] = {false, false, false, false, false, false, true, true, true};

struct DramSettings {
  int fidelity;            // 0, 1, 2
  double bytes_per_cycle;  // of the core's clock
  int latency;             // cycles
  int line_bytes, row_bytes, channels, banks, interleave_bytes, window, write_batch;
  // Cycles of the core's clock.
  double activate, precharge, row_active, activate_gap, four_activates, turn, refresh, refresh_interval;
};

class Dram {
 public:
  explicit Dram(const DramSettings& settings);

  // Asks for `lines` lines from a byte address on, which is rounded down to a line.
  void ask(Stream stream, int64_t address, int64_t lines);
  void step(int64_t now);

  bool is_idle() const { return pending_ == 0 && in_flight_ == 0; }
  int64_t asked(Stream stream) const { return asked_[stream]; }
  int64_t arrived(Stream stream) const { return arrived_[stream]; }

  int64_t num_activations = 0, num_row_hits = 0, busy_cycles = 0, num_served = 0;

 private:
  struct Run {
    int64_t line, count;
  };
  struct Waiting {
    int64_t row;
    Stream stream;
    int bank;
  };
  struct Bank {
    int64_t row = -1;
    double ready = 0, opened = -1e18, closed = 0;  // when its data may start; when its row was opened; from when one may be
  };
  struct Channel {
    std::vector<Waiting> window;
    std::vector<Bank> banks;
    double bus_free = 0, last_activation = -1e18, activations[4] = {-1e18, -1e18, -1e18, -1e18};
    int next_activation = 0;
    bool writes = false;
  };

  void step_bus(double share);
  void step_channels();
  void fill_window(Channel& channel, int index);
  void open_rows(Channel& channel);
  bool serve_one(Channel& channel);
  int pick();
  bool jumps(Stream stream) const;
  void deliver(Stream stream, int64_t due);
  int64_t take(Stream stream);

  const DramSettings s_;
  std::deque<Run> runs_[NUM_STREAMS];
  int64_t waiting_[NUM_STREAMS] = {}, asked_[NUM_STREAMS] = {}, arrived_[NUM_STREAMS] = {};
  int64_t last_line_[NUM_STREAMS];
  double stream_ready_[NUM_STREAMS] = {};
  std::vector<int32_t> due_;  // lines of each stream by the cycle of their arrival
  std::vector<Channel> channels_;
  int64_t pending_ = 0, in_flight_ = 0, pending_writes_ = 0, now_ = 0;
  double credit_ = 0, blocked_until_ = 0, next_refresh_;
  int next_stream_ = 0;
  bool writes_ = false;
};

}  // namespace splatree::machine
