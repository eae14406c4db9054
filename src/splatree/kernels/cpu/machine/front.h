// Step 0 to the lists of the tiles: identification, step 1, step 2, distribution.
#pragma once
#include <deque>

#include "cpu/machine/engine.h"
#include "cpu/machine/identifier.h"

namespace splatree::machine {

class Front {
 public:
  Front(const Settings& s, const Clusters& clusters, Dram& dram, Result& result)
      : s_(s),
        clusters_(clusters),
        dram_(dram),
        result_(result),
        step1_(s.geometry, dram, GEOMETRY, result.units[STEP1], result.spans, STEP1),
        step2_(s.color, dram, COLOR, result.units[STEP2], result.spans, STEP2),
        record_lines_((clusters.num_visits * s.record_bytes + s.dram.line_bytes - 1) / s.dram.line_bytes),
        identifier_(s.interval, s.latency, s.selected_fifo) {}

  bool is_done() const { return is_done_; }

  // Whether anything went on.
  bool step(int64_t now) {
    moved_ = false;
    identify(now);
    feed_step1();
    step1_.step(
        now, [&](const Piece& p) { ask_rows(GEOMETRY, s_.geometry, p.first_row, p.rows); },
        [&](const Piece& p) { return pass_on(p); });
    if (!closed2_ && step1_.is_done()) closed2_ = true, step2_.close();
    step2_.step(now, [&](const Piece& p) { ask_colors(p); }, [&](const Piece& p) { return write(p); });
    distribute(now);
    is_done_ = step2_.is_done() && backlog_ < 1 && dram_.is_idle();
    return moved_ | step1_.moved() | step2_.moved();
  }

 private:
  // Records come line by line into a FIFO and go on to the identifier; a selected cluster goes on to step 1 if that has room.
  void identify(int64_t now) {
    if (!s_.identifies) return;
    UnitTime& time = result_.units[CIE];
    const int line = s_.dram.line_bytes;
    const int64_t asked = dram_.asked(RECORDS);
    if (asked < record_lines_ && (asked + 1) * line / s_.record_bytes - next_visit_ <= s_.record_fifo)
      dram_.ask(RECORDS, asked * line, 1);
    const int64_t here = std::min(clusters_.num_visits, dram_.arrived(RECORDS) * line / s_.record_bytes);
    for (; in_fifo_ < here; ++in_fifo_) records_since_.push_back(now), ++result_.records.pushes;
    count(result_.records, here - next_visit_);

    std::optional<Identifier::Visit> visit;
    if (here > next_visit_) {
      const int32_t cluster = clusters_.visits[next_visit_];
      visit = Identifier::Visit{cluster, cluster >= 0};
    }
    const bool takes = visit && identifier_.has_room(), is_ready = step1_.has_room();
    if (takes) {
      ++next_visit_, ++time.items, ++result_.records.pops;
      result_.records.waited += now + 1 - records_since_.front();
      records_since_.pop_front();
      if (time.first_start < 0) time.first_start = now;
    }
    const std::optional<int64_t> selected = identifier_.front();
    const size_t before = identifier_.num_selected();
    const Identifier::State state = identifier_.step(visit, is_ready);
    if (selected && is_ready) {
      result_.selected.waited += now + 1 - selected_since_.front();
      selected_since_.pop_front();
      ++result_.selected.pops;
      push(*selected);
    }
    if (identifier_.num_selected() + (selected && is_ready) > before)
      selected_since_.push_back(now + 1), ++result_.selected.pushes;
    count(result_.selected, int64_t(identifier_.num_selected()));
    moved_ |= takes || (selected && is_ready) || state == Identifier::BUSY;
    if (next_visit_ == clusters_.num_visits && identifier_.is_empty()) {
      ++time.idle;
      if (time.last_end == 0) time.last_end = now;
    } else if (state == Identifier::NO_ROOM) {
      ++time.stalled_on_output;
    } else {
      state == Identifier::BUSY ? ++time.busy : ++time.stalled_on_input;
    }
  }

  static void count(FifoStatistics& fifo, int64_t occupancy) {
    fifo.occupancy += occupancy;
    fifo.most = std::max(fifo.most, occupancy);
  }

  void feed_step1() {
    if (closed1_) return;
    if (!s_.identifies) {
      if (next_visit_ < clusters_.num_visits && step1_.has_room()) {
        const int32_t cluster = clusters_.visits[next_visit_++];
        if (cluster >= 0) push(cluster);
      }
      if (next_visit_ == clusters_.num_visits) closed1_ = true, step1_.close();
      return;
    }
    if (next_visit_ == clusters_.num_visits && identifier_.is_empty()) closed1_ = true, step1_.close();
  }

  void push(int64_t cluster) {
    const int64_t rows = clusters_.rows[cluster];
    if (rows == 0) return;
    result_.rows_in += rows;
    step1_.push({cluster, rows, clusters_.survivors[cluster], clusters_.pairs[cluster], clusters_.first_row[cluster], rows});
  }

  void ask_rows(Stream stream, const EngineSettings& engine, int64_t first, int64_t rows) {
    const int64_t begin = engine.base + first * engine.row_bytes, end = begin + rows * engine.row_bytes;
    const int64_t line = s_.dram.line_bytes;
    dram_.ask(stream, begin, (end + line - 1) / line - begin / line);
  }

  // The survivors of a piece of step 1 are rows of step 2.
  bool pass_on(const Piece& piece) {
    if (piece.survivors == 0) return true;
    if (!step2_.has_room()) return false;
    step2_.push({piece.cluster, piece.survivors, piece.survivors, piece.pairs, piece.first_row, piece.rows});
    return true;
  }

  // Colours are gathered survivor by survivor, or all of the run is read where most of it is wanted.
  void ask_colors(const Piece& piece) {
    if (double(piece.rows) >= s_.streamed_share * double(piece.span_rows))
      return ask_rows(COLOR, s_.color, piece.first_row, piece.span_rows);
    for (int64_t i = 0; i < piece.rows; ++i) ask_rows(COLOR, s_.color, piece.first_row + i * piece.span_rows / piece.rows, 1);
  }

  bool write(const Piece& piece) {
    if (backlog_ > 0 && backlog_ + double(piece.pairs) > double(s_.pair_backlog)) return false;
    result_.survivors_out += piece.rows;
    backlog_ += double(piece.pairs);
    splat_bytes_ += piece.rows * s_.splat_bytes;
    const int64_t lines = splat_bytes_ / s_.dram.line_bytes;
    splat_bytes_ -= lines * s_.dram.line_bytes;
    dram_.ask(PROJECTED, splats_written_ * s_.dram.line_bytes, lines);
    splats_written_ += lines;
    return true;
  }

  void distribute(int64_t now) {
    UnitTime& time = result_.units[DISTRIBUTION];
    if (backlog_ <= 0) {
      step2_.is_done() ? ++time.idle : ++time.stalled_on_input;
      flush();
      return;
    }
    if (time.first_start < 0) time.first_start = now;
    ++time.busy;
    moved_ = true;
    const double pairs = std::min(backlog_, s_.pairs_per_cycle);
    backlog_ -= pairs;
    distributed_ += pairs;
    time.last_end = now;
    result_.pairs_out = int64_t(distributed_ + 0.5);
    write_lists(int64_t(distributed_ * s_.list_lines_per_pair));
    flush();
  }

  // The last lines are not full.
  void flush() {
    if (is_flushed_ || !step2_.is_done() || backlog_ > 0) return;
    is_flushed_ = true;
    write_lists(int64_t(std::ceil(distributed_ * s_.list_lines_per_pair - 1e-6)));
    if (splat_bytes_ > 0) dram_.ask(PROJECTED, splats_written_ * s_.dram.line_bytes, 1);
  }

  void write_lists(int64_t lines) {
    dram_.ask(PAIRS, lists_written_ * s_.dram.line_bytes, lines - lists_written_);
    lists_written_ = std::max(lists_written_, lines);
  }

  const Settings& s_;
  const Clusters& clusters_;
  Dram& dram_;
  Result& result_;
  Engine step1_, step2_;
  const int64_t record_lines_;
  Identifier identifier_;
  std::deque<int64_t> records_since_, selected_since_;
  int64_t next_visit_ = 0, in_fifo_ = 0, splat_bytes_ = 0, splats_written_ = 0, lists_written_ = 0;
  double backlog_ = 0, distributed_ = 0;
  bool closed1_ = false, closed2_ = false, is_done_ = false, is_flushed_ = false, moved_ = false;
};

}  // namespace splatree::machine
