#include "cpu/machine/dram.h"

#include <algorithm>
#include <cmath>

namespace splatree::machine {
namespace {

constexpr int HORIZON = 1 << 14;  // cycles that an arrival may lie ahead

}  // namespace

Dram::Dram(const DramSettings& settings)
    : s_(settings), due_(size_t(HORIZON) * NUM_STREAMS), next_refresh_(settings.refresh_interval) {
  std::fill(std::begin(last_line_), std::end(last_line_), int64_t(-2));
  if (s_.fidelity == 2) {
    channels_.resize(s_.channels);
    for (Channel& channel : channels_) channel.banks.resize(s_.banks);
  }
}

void Dram::ask(Stream stream, int64_t address, int64_t lines) {
  if (lines <= 0) return;
  runs_[stream].push_back({address / s_.line_bytes, lines});
  waiting_[stream] += lines, asked_[stream] += lines, pending_ += lines;
  if (IS_WRITE[stream]) pending_writes_ += lines;
}

void Dram::step(int64_t now) {
  now_ = now;
  int32_t* due = &due_[size_t(now % HORIZON) * NUM_STREAMS];
  for (int i = 0; i < NUM_STREAMS; ++i) {
    arrived_[i] += due[i], in_flight_ -= due[i];
    due[i] = 0;
  }
  if (s_.fidelity == 2) return step_channels();
  double share = 1;
  if (s_.fidelity == 1) share = s_.refresh_interval > 0 ? 1 - s_.refresh / s_.refresh_interval : 1;
  step_bus(share);
}

// The next line of a stream.
int64_t Dram::take(Stream stream) {
  Run& run = runs_[stream].front();
  const int64_t line = run.line++;
  if (--run.count == 0) runs_[stream].pop_front();
  --waiting_[stream], --pending_;
  if (IS_WRITE[stream]) --pending_writes_;
  last_line_[stream] = line;
  return line;
}

void Dram::deliver(Stream stream, int64_t due) {
  ++num_served;
  if (IS_WRITE[stream]) {
    ++arrived_[stream];
    return;
  }
  ++in_flight_;
  ++due_[size_t(due % HORIZON) * NUM_STREAMS + stream];
}

// The stream to serve, or -1: records of clusters first, the others in turn; writes in batches. A stream that jumps to another
// row waits until it is open, and others are served meanwhile.
int Dram::pick() {
  const bool has_reads = pending_ > pending_writes_;
  const bool writes = pending_writes_ > 0 && (!has_reads || writes_ || pending_writes_ >= s_.write_batch);
  if (s_.fidelity == 1 && writes != writes_) blocked_until_ = double(now_) + s_.turn;
  writes_ = writes;
  if (double(now_) < blocked_until_) return -1;
  for (int i = -1; i < NUM_STREAMS; ++i) {
    const int stream = i < 0 ? int(RECORDS) : (next_stream_ + i) % NUM_STREAMS;
    if (!waiting_[stream] || IS_WRITE[stream] != writes || stream_ready_[stream] > double(now_)) continue;
    if (s_.fidelity == 1 && jumps(Stream(stream))) {
      stream_ready_[stream] = double(now_) + s_.precharge + s_.activate;
      last_line_[stream] = runs_[stream].front().line - 1;  // from here on it follows
      ++num_activations;
      continue;
    }
    if (i >= 0) next_stream_ = (stream + 1) % NUM_STREAMS;
    return stream;
  }
  return -1;
}

// Whether a stream's next line lies neither behind its last nor in the same row.
bool Dram::jumps(Stream stream) const {
  const int64_t lines_per_row = s_.row_bytes / s_.line_bytes, line = runs_[stream].front().line;
  return line != last_line_[stream] + 1 && line / lines_per_row != last_line_[stream] / lines_per_row;
}

void Dram::step_bus(double share) {
  const double line = s_.line_bytes;
  credit_ = std::min(credit_ + share * s_.bytes_per_cycle, std::max(line, s_.bytes_per_cycle) + line);
  bool used = false;
  while (pending_ && credit_ >= line) {
    const int stream = pick();
    if (stream < 0) break;
    const int64_t at = take(Stream(stream));
    if (at % (s_.row_bytes / s_.line_bytes) == 0)
      ++num_activations;
    else
      ++num_row_hits;
    deliver(Stream(stream), now_ + s_.latency);
    credit_ -= line;
    used = true;
  }
  if (!pending_) credit_ = std::min(credit_, line);  // a bus that has had nothing to do is not faster afterwards
  busy_cycles += used || credit_ < line;
}

// Lines go to channels by their address; each channel looks at the first so many of its streams.
void Dram::fill_window(Channel& channel, int index) {
  const int64_t lines_per_turn = s_.interleave_bytes / s_.line_bytes;
  for (int i = 0; i < NUM_STREAMS && int(channel.window.size()) < s_.window; ++i) {
    const Stream stream = Stream((next_stream_ + i) % NUM_STREAMS);
    for (int taken = 0; taken < 8 && waiting_[stream] && int(channel.window.size()) < s_.window; ++taken) {
      const int64_t line = runs_[stream].front().line;
      const int64_t turn = line / lines_per_turn;
      if (turn % s_.channels != index) break;
      const int64_t in_channel = (turn / s_.channels) * lines_per_turn + line % lines_per_turn;
      const int64_t row = in_channel * s_.line_bytes / s_.row_bytes;
      take(stream);
      ++pending_;  // it is still to be served
      if (IS_WRITE[stream]) ++pending_writes_;
      channel.window.push_back({row / s_.banks, stream, int(row % s_.banks)});
    }
  }
}

// Closes the row of each bank that no line in the window asks for, and opens that of its oldest line. A command is given when its
// time has come: one that lay ahead would hold up those of other banks.
void Dram::open_rows(Channel& channel) {
  uint64_t looked_at = 0;
  for (const Waiting& w : channel.window) {
    const uint64_t bit = uint64_t(1) << w.bank;
    if (looked_at & bit) continue;
    looked_at |= bit;
    Bank& bank = channel.banks[w.bank];
    if (bank.row == w.row) continue;
    bool is_wanted = false;
    for (const Waiting& other : channel.window) is_wanted |= other.bank == w.bank && other.row == bank.row;
    if (is_wanted) continue;
    if (bank.row >= 0) {
      const double from = std::max(bank.opened + s_.row_active, bank.ready);
      if (from > double(now_)) continue;
      bank.row = -1, bank.closed = std::max(from, double(now_) - 1) + s_.precharge;
    }
    double at = std::max(bank.closed, channel.last_activation + s_.activate_gap);
    at = std::max(at, channel.activations[channel.next_activation] + s_.four_activates);
    if (at > double(now_)) continue;
    at = std::max(at, double(now_) - 1);
    bank.row = w.row, bank.opened = at, bank.ready = at + s_.activate;
    channel.last_activation = at;
    channel.activations[channel.next_activation] = at;
    channel.next_activation = (channel.next_activation + 1) % 4;
    ++num_activations;
  }
}

bool Dram::serve_one(Channel& channel) {
  if (channel.window.empty() || channel.bus_free > double(now_)) return false;
  int num_writes = 0;
  for (const Waiting& w : channel.window) num_writes += IS_WRITE[w.stream];
  const bool only_writes = num_writes == int(channel.window.size());
  const bool prefers_writes = num_writes && (only_writes || channel.writes || num_writes >= s_.write_batch);
  // The oldest line of an open row; of the other direction only if there is none of the preferred one.
  size_t best = channel.window.size();
  for (size_t i = 0; i < channel.window.size(); ++i) {
    const Waiting& w = channel.window[i];
    const Bank& bank = channel.banks[w.bank];
    if (bank.row != w.row || bank.ready > double(now_)) continue;
    if (IS_WRITE[w.stream] == prefers_writes) {
      best = i;
      break;
    }
    if (best == channel.window.size()) best = i;
  }
  if (best == channel.window.size()) return false;
  const Waiting w = channel.window[best];
  channel.window.erase(channel.window.begin() + int64_t(best));
  const double cycles = s_.line_bytes / (s_.bytes_per_cycle / s_.channels);
  const bool writes = IS_WRITE[w.stream];
  const double turn = writes != channel.writes ? s_.turn : 0;
  channel.writes = writes;
  channel.bus_free = std::max(channel.bus_free, double(now_) - 1) + turn + cycles;
  channel.banks[w.bank].ready = std::max(channel.banks[w.bank].ready, double(now_));
  --pending_;
  if (IS_WRITE[w.stream]) --pending_writes_;
  ++num_row_hits;
  deliver(w.stream, std::max(now_ + 1, int64_t(std::ceil(channel.bus_free)) + s_.latency));
  return true;
}

void Dram::step_channels() {
  if (s_.refresh_interval > 0 && double(now_) >= next_refresh_) {
    next_refresh_ += s_.refresh_interval;
    blocked_until_ = double(now_) + s_.refresh;
    for (Channel& channel : channels_)
      for (Bank& bank : channel.banks) bank.row = -1, bank.ready = bank.closed = blocked_until_;
  }
  bool used = false;
  for (size_t i = 0; i < channels_.size(); ++i) {
    fill_window(channels_[i], int(i));
    if (double(now_) < blocked_until_) continue;
    open_rows(channels_[i]);
    while (serve_one(channels_[i])) used = true;
    used |= channels_[i].bus_free > double(now_);
  }
  next_stream_ = (next_stream_ + 1) % NUM_STREAMS;
  busy_cycles += used;
}

}  // namespace splatree::machine
