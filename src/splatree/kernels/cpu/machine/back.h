// From the tiles' lists to the picture: each list is read, sorted and blended; the next is read and sorted meanwhile.
#pragma once
#include <deque>

#include "cpu/machine/engine.h"

namespace splatree::machine {

class Back {
 public:
  Back(const Settings& s, const Tiles& tiles, Dram& dram, Result& result)
      : s_(s), tiles_(tiles), dram_(dram), result_(result), renderers_(size_t(s.renderers)) {}

  bool is_done() const { return done_ == tiles_.count && dram_.is_idle(); }

  // Whether anything went on.
  bool step(int64_t now) {
    moved_ = false;
    read_lists();
    sort(now);
    blend(now);
    return moved_;
  }

 private:
  struct Sorted {
    int64_t tile, last_line;  // of its projected records
  };
  struct Renderer {
    int64_t tile = -1, begin = 0, cycles = 0, last_line = 0;
  };

  void read_lists() {
    if (asked_ == tiles_.count || asked_ - sorted_ >= s_.tiles_waiting) return;
    dram_.ask(LISTS, list_line_ * s_.dram.line_bytes, tiles_.list_lines[asked_]);
    list_line_ += tiles_.list_lines[asked_++];
    lists_.push_back(dram_.asked(LISTS));
    moved_ = true;
  }

  void sort(int64_t now) {
    UnitTime& time = result_.units[SORT];
    if (sorting_ < 0) {
      if (lists_.empty()) {
        sorted_ == tiles_.count ? ++time.idle : ++time.stalled_on_input;
        return;
      }
      if (dram_.arrived(LISTS) < lists_.front()) {
        ++time.stalled_on_input;
        return;
      }
      lists_.pop_front();
      sorting_ = sorted_, sort_end_ = now + tiles_.sort_cycles[sorting_];
      if (time.first_start < 0) time.first_start = now;
    }
    if (now < sort_end_) {
      ++time.busy;
      moved_ = true;
      return;
    }
    if (int(ready_.size()) >= s_.tiles_waiting) {
      ++time.stalled_on_output;
      return;
    }
    ++time.busy;
    moved_ = true;
    ++time.items;
    time.last_end = now;
    dram_.ask(SPLATS, projected_line_ * s_.dram.line_bytes, tiles_.projected_lines[sorting_]);
    projected_line_ += 7 * tiles_.projected_lines[sorting_];  // records lie anywhere
    ready_.push_back({sorting_, dram_.asked(SPLATS)});
    ++sorted_;
    sorting_ = -1;
  }

  void blend(int64_t now) {
    UnitTime& time = result_.units[BLEND];
    bool works = false, waits = false;
    for (Renderer& r : renderers_) {
      if (r.tile >= 0 && now >= r.begin + r.cycles && dram_.arrived(SPLATS) >= r.last_line) finish(r, now, time);
      if (r.tile < 0 && !ready_.empty()) {
        const Sorted& next = ready_.front();
        r = {next.tile, now, tiles_.blend_cycles[next.tile] + s_.blend_latency, next.last_line};
        ready_.pop_front();
        if (time.first_start < 0) time.first_start = now;
        moved_ = true;
      }
      works |= r.tile >= 0 && now < r.begin + r.cycles;
      waits |= r.tile >= 0;
    }
    moved_ |= works;
    if (works)
      ++time.busy;
    else if (waits || done_ < tiles_.count)
      ++time.stalled_on_input;
    else
      ++time.idle;
  }

  void finish(Renderer& r, int64_t now, UnitTime& time) {
    dram_.ask(FRAME, frame_line_ * s_.dram.line_bytes, tiles_.frame_lines[r.tile]);
    frame_line_ += tiles_.frame_lines[r.tile];
    if (result_.spans.size() < MAX_SPANS) result_.spans.push_back({BLEND, r.begin, now, 1});
    r.tile = -1;
    ++done_, ++time.items, ++result_.tiles_out;
    time.last_end = now;
    moved_ = true;
  }

  static constexpr size_t MAX_SPANS = 1 << 15;
  const Settings& s_;
  const Tiles& tiles_;
  Dram& dram_;
  Result& result_;
  std::vector<Renderer> renderers_;
  std::deque<int64_t> lists_;
  std::deque<Sorted> ready_;
  int64_t asked_ = 0, sorted_ = 0, done_ = 0, sorting_ = -1, sort_end_ = 0, list_line_ = 0, projected_line_ = 0, frame_line_ = 0;
  bool moved_ = false;
};

}  // namespace splatree::machine
