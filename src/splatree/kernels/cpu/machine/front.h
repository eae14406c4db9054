// Step 0 to the lists of the tiles: identification, selection of levels, step 1, step 2, distribution.
#pragma once
#include <deque>
#include <numeric>

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
        selection_(s.levels, dram, LEVELS, result.units[SELECTION], result.spans, SELECTION),
        step1_(s.geometry, dram, GEOMETRY, result.units[STEP1], result.spans, STEP1),
        step2_(s.color, dram, COLOR, result.units[STEP2], result.spans, STEP2),
        record_lines_((clusters.num_visits * s.record_bytes + s.dram.line_bytes - 1) / s.dram.line_bytes),
        identifier_(s.interval, s.latency, s.selected_fifo) {}

  bool is_done() const { return is_done_; }

  // Whether anything went on.
  bool step(int64_t now) {
    moved_ = false;
    identify(now);
    feed();
    if (s_.selects_levels) {
      selection_.step(
          now, [&](const Piece& p) { dram_.ask(LEVELS, s_.levels.base + p.first_row * s_.dram.line_bytes, p.span_rows); },
          [&](const Piece& p) { return select(p); });
      if (!closed1_ && selection_.is_done()) closed1_ = true, step1_.close();
    }
    step1_.step(now, [&](const Piece& p) { ask_geometry(p); }, [&](const Piece& p) { return pass_on(p); });
    if (!closed2_ && step1_.is_done()) closed2_ = true, step2_.close();
    step2_.step(now, [&](const Piece& p) { ask_colors(p); }, [&](const Piece& p) { return write(p); });
    distribute(now);
    is_done_ = step2_.is_done() && backlog_ < 1 && dram_.is_idle();
    return moved_ || selection_.moved() || step1_.moved() || step2_.moved();
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
    const bool takes = visit && identifier_.has_room(), is_ready = first().has_room();
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

  // What kept clusters go to.
  Engine& first() { return s_.selects_levels ? selection_ : step1_; }

  void feed() {
    if (closed_) return;
    if (!s_.identifies && next_visit_ < clusters_.num_visits && first().has_room()) {
      const int32_t cluster = clusters_.visits[next_visit_++];
      if (cluster >= 0) push(cluster);
    }
    if (next_visit_ < clusters_.num_visits || (s_.identifies && !identifier_.is_empty())) return;
    closed_ = true;
    first().close();
    if (!s_.selects_levels) closed1_ = true;
  }

  void push(int64_t cluster) {
    if (!s_.selects_levels) return push_step1(cluster);
    const int64_t walked = clusters_.walked[cluster], line = s_.dram.line_bytes;
    if (walked == 0) return;
    const int64_t first = clusters_.first_row[cluster] * s_.levels.row_bytes / line;
    selection_.push({cluster, walked, 0, 0, first, clusters_.walk_lines[cluster]});
  }

  void push_step1(int64_t cluster) {
    const int64_t rows = clusters_.rows[cluster];
    if (rows == 0) return;
    result_.rows_in += rows;
    step1_.push({cluster, rows, clusters_.survivors[cluster], clusters_.pairs[cluster], clusters_.first_row[cluster],
                 clusters_.span_rows[cluster]});
  }

  // A cluster goes on when the last of its rows was looked at.
  bool select(const Piece& piece) {
    const bool is_last = walked_ + piece.rows == clusters_.walked[piece.cluster];
    if (is_last && !step1_.has_room()) return false;
    walked_ = is_last ? 0 : walked_ + piece.rows;
    if (is_last) push_step1(piece.cluster);
    return true;
  }

  // Rows that lie apart are gathered, unless all between them take fewer lines.
  void ask_geometry(const Piece& piece) {
    const int64_t size = s_.geometry.row_bytes, line = s_.dram.line_bytes;
    const double touched = 1 + double(size - std::gcd(size, line)) / double(line);  // on average over where rows begin
    if (piece.rows == piece.span_rows || double(piece.rows) * touched >= double(piece.span_rows * size) / double(line))
      return ask_rows(GEOMETRY, s_.geometry, piece.first_row, piece.span_rows);
    gather(GEOMETRY, s_.geometry, piece);
  }

  void gather(Stream stream, const EngineSettings& engine, const Piece& piece) {
    for (int64_t i = 0; i < piece.rows; ++i) ask_rows(stream, engine, piece.first_row + i * piece.span_rows / piece.rows, 1);
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
    step2_.push({piece.cluster, piece.survivors, piece.survivors, piece.pairs, piece.first_row, piece.span_rows});
    return true;
  }

  // Colours are gathered survivor by survivor, or all of the run is read where most of it is wanted.
  void ask_colors(const Piece& piece) {
    if (double(piece.rows) >= s_.streamed_share * double(piece.span_rows))
      return ask_rows(COLOR, s_.color, piece.first_row, piece.span_rows);
    gather(COLOR, s_.color, piece);
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
  Engine selection_, step1_, step2_;
  const int64_t record_lines_;
  Identifier identifier_;
  std::deque<int64_t> records_since_, selected_since_;
  int64_t next_visit_ = 0, in_fifo_ = 0, splat_bytes_ = 0, splats_written_ = 0, lists_written_ = 0, walked_ = 0;
  double backlog_ = 0, distributed_ = 0;
  bool closed_ = false, closed1_ = false, closed2_ = false, is_done_ = false, is_flushed_ = false, moved_ = false;
};

}  // namespace splatree::machine
