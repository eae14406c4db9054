// An engine with a buffer of one or two halves: one half is filled from DRAM while the rows of the other are computed.
#pragma once
#include <algorithm>
#include <cmath>
#include <deque>
#include <vector>

#include "cpu/machine/simulate.h"

namespace splatree::machine {

// Consecutive rows of a cluster.
struct Piece {
  int64_t cluster, rows, survivors, pairs;
  int64_t first_row;  // in DRAM
  int64_t span_rows;  // rows from the first to the last of which they are
};

class Engine {
 public:
  Engine(const EngineSettings& settings, Dram& dram, Stream stream, UnitTime& time, std::vector<Span>& spans, int unit)
      : s_(settings), dram_(dram), stream_(stream), time_(time), spans_(spans), unit_(unit), halves_(settings.halves) {}

  bool has_room() const { return queue_.size() < QUEUE; }
  void push(const Piece& piece) { queue_.push_back(piece); }
  // No piece will come any more.
  void close() { closed_ = true; }
  bool is_done() const { return closed_ && queue_.empty() && !computes_ && outputs_.empty() && all_empty(); }
  bool moved() const { return moved_; }

  // Lines of DRAM that a piece takes; a policy of the stream.
  template <class Lines, class Emit>
  void step(int64_t now, const Lines& lines_of, const Emit& emit) {
    moved_ = false;
    fill(lines_of);
    compute(now, emit);
  }

 private:
  static constexpr size_t QUEUE = 64;
  struct Half {
    std::vector<Piece> pieces;
    int64_t rows = 0, last_line = 0;
    bool full = false;
  };
  struct Output {
    int64_t due;
    Piece piece;
  };

  bool all_empty() const {
    return std::all_of(halves_.begin(), halves_.end(), [](const Half& half) { return half.pieces.empty(); });
  }

  // One piece a cycle goes into the half that is being filled.
  template <class Lines>
  void fill(const Lines& lines_of) {
    Half& half = halves_[filling_];
    if (half.full) return;
    if (!queue_.empty()) {
      Piece& next = queue_.front();
      Piece taken = next;
      taken.rows = std::min(next.rows, int64_t(s_.capacity) - half.rows);
      const double share = double(taken.rows) / double(next.rows);
      if (taken.rows < next.rows) {
        taken.survivors = int64_t(double(next.survivors) * share);
        taken.pairs = int64_t(double(next.pairs) * share);
        taken.span_rows = next.span_rows * taken.rows / next.rows;
      }
      lines_of(taken);
      half.last_line = dram_.asked(stream_);
      half.rows += taken.rows;
      half.pieces.push_back(taken);
      next.rows -= taken.rows, next.survivors -= taken.survivors, next.pairs -= taken.pairs;
      next.first_row += taken.span_rows, next.span_rows -= taken.span_rows;
      if (next.rows == 0) queue_.pop_front();
      moved_ = true;
    }
    half.full = half.rows == s_.capacity || (closed_ && queue_.empty() && half.rows > 0);
    if (half.full && halves_.size() > 1) filling_ = 1 - filling_;
  }

  template <class Emit>
  void compute(int64_t now, const Emit& emit) {
    // What has left the pipeline goes on, if there is room for it.
    const bool blocked = !outputs_.empty() && outputs_.front().due <= now && !emit(outputs_.front().piece);
    if (!outputs_.empty() && outputs_.front().due <= now && !blocked) {
      time_.last_end = now;
      outputs_.pop_front();
      moved_ = true;
    }
    Half& half = halves_[computing_];
    if (!computes_ && half.full && dram_.arrived(stream_) >= half.last_line) {
      computes_ = true, begun_ = now, done_ = 0, next_piece_ = 0, of_piece_ = 0;
      if (time_.first_start < 0) time_.first_start = now;
    }
    if (!computes_) {
      if (closed_ && queue_.empty() && all_empty())
        ++time_.idle;
      else
        ++time_.stalled_on_input;
      return;
    }
    if (blocked || outputs_.size() >= QUEUE) {
      ++time_.stalled_on_output;
      return;
    }
    ++time_.busy;
    moved_ = true;
    done_ = std::min(done_ + s_.lanes, double(half.rows));
    while (next_piece_ < half.pieces.size() && of_piece_ + double(half.pieces[next_piece_].rows) <= done_ + 1e-9) {
      const Piece& piece = half.pieces[next_piece_++];
      of_piece_ += double(piece.rows);
      time_.items += piece.rows;
      outputs_.push_back({now + s_.latency, piece});
    }
    if (next_piece_ < half.pieces.size()) return;
    if (spans_.size() < MAX_SPANS) spans_.push_back({unit_, begun_, now + 1, half.rows});
    half = Half{};
    computes_ = false;
    if (halves_.size() > 1) computing_ = 1 - computing_;
  }

  static constexpr size_t MAX_SPANS = 1 << 14;
  const EngineSettings s_;
  Dram& dram_;
  const Stream stream_;
  UnitTime& time_;
  std::vector<Span>& spans_;
  const int unit_;
  std::deque<Piece> queue_;
  std::vector<Half> halves_;
  std::deque<Output> outputs_;
  size_t filling_ = 0, computing_ = 0, next_piece_ = 0;
  bool closed_ = false, computes_ = false, moved_ = false;
  int64_t begun_ = 0;
  double done_ = 0, of_piece_ = 0;
};

}  // namespace splatree::machine
