// The cluster identification engine, cycle for cycle as the circuit of hardware/rtl: a FIFO, a pipeline that stands still as a
// whole, and a FIFO. Tests hold the two to each other.
#pragma once
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

namespace splatree::machine {

// A FIFO whose last entry is a register, as Amaranth's SyncFIFOBuffered: an entry can be read two cycles after it was written.
template <class T>
class BufferedFifo {
 public:
  explicit BufferedFifo(size_t depth) : inner_depth_(depth - 1) {}

  bool has_room() const { return inner_.size() != inner_depth_; }
  const std::optional<T>& front() const { return out_; }
  size_t size() const { return inner_.size() + out_.has_value(); }

  // One cycle: `written` goes in if there is room, and the front goes out if `is_read`.
  void step(const std::optional<T>& written, bool is_read) {
    const bool takes = written && has_room();
    const bool moves = !inner_.empty() && (!out_ || is_read);
    if (moves) {
      out_ = inner_.front();
      inner_.pop_front();
    } else if (is_read) {
      out_.reset();
    }
    if (takes) inner_.push_back(*written);
  }

 private:
  const size_t inner_depth_;
  std::deque<T> inner_;
  std::optional<T> out_;
};

class Identifier {
 public:
  static constexpr int FIFO_CYCLES = 2;  // through each FIFO
  static constexpr size_t WAITING = 16;

  struct Visit {
    int64_t number;
    bool is_kept;
  };
  enum State { BUSY, NO_INPUT, NO_ROOM };

  // `latency` cycles from the input to the output, both FIFOs included; a cluster enters the pipeline each `interval` cycles.
  Identifier(int interval, int latency, int selected_fifo)
      : interval_(interval), pipe_(size_t(latency - 2 * FIFO_CYCLES)), waiting_(WAITING), chosen_(size_t(selected_fifo)) {}

  bool has_room() const { return waiting_.has_room(); }
  const std::optional<int64_t>& front() const { return chosen_.front(); }
  size_t num_selected() const { return chosen_.size(); }
  bool is_empty() const { return in_flight_ == 0; }

  State step(const std::optional<Visit>& visit, bool is_ready) {
    if (visit && has_room()) ++in_flight_;
    const std::optional<Visit> last = pipe_.back();
    const bool selects = last && last->is_kept;
    const bool advances = !selects || chosen_.has_room();
    if (chosen_.front() && is_ready) --in_flight_;
    chosen_.step(selects ? std::optional<int64_t>(last->number) : std::nullopt, is_ready);
    if (advances && last && !selects) --in_flight_;
    enabled_ += advances;
    const bool enters = advances && waiting_.front() && enabled_ >= next_entry_;
    bool has_work = enters;
    if (advances) {
      for (size_t i = pipe_.size() - 1; i > 0; --i) {
        pipe_[i] = pipe_[i - 1];
        has_work |= pipe_[i].has_value();
      }
      pipe_[0].reset();
      if (enters) {
        pipe_[0] = waiting_.front();
        next_entry_ = enabled_ + interval_;
      }
    }
    const bool is_between = waiting_.front() && !enters;
    waiting_.step(visit, enters);
    if (!advances) return NO_ROOM;
    return has_work || is_between ? BUSY : NO_INPUT;
  }

 private:
  const int interval_;
  std::vector<std::optional<Visit>> pipe_;
  BufferedFifo<Visit> waiting_;
  BufferedFifo<int64_t> chosen_;
  int64_t enabled_ = 0, next_entry_ = 0, in_flight_ = 0;
};

}  // namespace splatree::machine
