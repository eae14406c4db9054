// Glue of the accelerator: settings come as a dictionary of named numbers, what was found goes back as one.
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "cpu/machine/identifier.h"
#include "cpu/machine/simulate.h"
#include "cpu/runtime/arrays.h"

namespace splatree {
namespace {

using namespace machine;

class Numbers {
 public:
  explicit Numbers(nb::dict values) : values_(std::move(values)) {}

  double real(const char* name) const { return nb::cast<double>(values_[name]); }
  int64_t whole(const char* name) const { return nb::cast<int64_t>(values_[name]); }
  int count(const char* name) const { return int(whole(name)); }
  bool flag(const char* name) const { return nb::cast<bool>(values_[name]); }
  Numbers group(const char* name) const { return Numbers(nb::cast<nb::dict>(values_[name])); }

 private:
  nb::dict values_;
};

DramSettings dram_of(const Numbers& n) {
  DramSettings s{};
  s.fidelity = n.count("fidelity"), s.bytes_per_cycle = n.real("bytes_per_cycle"), s.latency = n.count("latency");
  s.line_bytes = n.count("line_bytes"), s.row_bytes = n.count("row_bytes"), s.channels = n.count("channels");
  s.banks = n.count("banks"), s.interleave_bytes = n.count("interleave_bytes"), s.window = n.count("window");
  s.write_batch = n.count("write_batch");
  s.activate = n.real("activate"), s.precharge = n.real("precharge"), s.row_active = n.real("row_active");
  s.activate_gap = n.real("activate_gap"), s.four_activates = n.real("four_activates"), s.turn = n.real("turn");
  s.refresh = n.real("refresh"), s.refresh_interval = n.real("refresh_interval");
  return s;
}

EngineSettings engine_of(const Numbers& n) {
  return {n.real("lanes"), n.count("latency"), n.count("capacity"), n.count("halves"), n.whole("row_bytes"), n.whole("base")};
}

Settings settings_of(const Numbers& n) {
  Settings s{};
  s.dram = dram_of(n.group("dram"));
  s.identifies = n.flag("identifies"), s.interval = n.count("interval"), s.latency = n.count("latency");
  s.record_fifo = n.count("record_fifo"), s.selected_fifo = n.count("selected_fifo"), s.record_bytes = n.whole("record_bytes");
  s.selects_levels = n.flag("selects_levels");
  s.levels = engine_of(n.group("levels"));
  s.geometry = engine_of(n.group("geometry")), s.color = engine_of(n.group("color"));
  s.streamed_share = n.real("streamed_share");
  s.splat_bytes = n.whole("splat_bytes"), s.pair_bytes = n.whole("pair_bytes");
  s.pairs_per_cycle = n.real("pairs_per_cycle"), s.pair_backlog = n.whole("pair_backlog");
  s.list_lines_per_pair = n.real("list_lines_per_pair");
  s.renderers = n.count("renderers"), s.sort_latency = n.count("sort_latency"), s.blend_latency = n.count("blend_latency");
  s.tiles_waiting = n.count("tiles_waiting"), s.overlaps = n.flag("overlaps");
  return s;
}

nb::dict dict_of(const UnitTime& t) {
  nb::dict d;
  d["busy"] = t.busy, d["stalled_on_input"] = t.stalled_on_input, d["stalled_on_output"] = t.stalled_on_output;
  d["idle"] = t.idle, d["first_start"] = t.first_start, d["last_end"] = t.last_end, d["items"] = t.items;
  return d;
}

nb::dict dict_of(const FifoStatistics& f) {
  nb::dict d;
  d["pushes"] = f.pushes, d["pops"] = f.pops, d["occupancy"] = f.occupancy, d["waited"] = f.waited, d["most"] = f.most;
  return d;
}

nb::dict simulate_frame(nb::dict settings, nb::dict clusters, nb::dict tiles) {
  const Settings s = settings_of(Numbers(settings));
  const auto column = [](const nb::dict& d, const char* name) { return nb::cast<In<int64_t>>(d[name]); };
  const auto visits = nb::cast<In<int32_t>>(clusters["visits"]);
  const auto first_row = column(clusters, "first_row"), rows = column(clusters, "rows");
  const auto survivors = column(clusters, "survivors"), pairs = column(clusters, "pairs");
  const auto span_rows = column(clusters, "span_rows");
  const auto walked = column(clusters, "walked"), walk_lines = column(clusters, "walk_lines");
  const auto list_lines = column(tiles, "list_lines"), sort_cycles = column(tiles, "sort_cycles");
  const auto projected_lines = column(tiles, "projected_lines"), blend_cycles = column(tiles, "blend_cycles");
  const auto frame_lines = column(tiles, "frame_lines");
  const Clusters c{visits.data(),    int64_t(visits.shape(0)), first_row.data(), span_rows.data(),
                   rows.data(),      survivors.data(),         pairs.data(),     walked.data(),
                   walk_lines.data()};
  const Tiles t{list_lines.data(),   sort_cycles.data(), projected_lines.data(),
                blend_cycles.data(), frame_lines.data(), int64_t(list_lines.shape(0))};
  Result r;
  {
    nb::gil_scoped_release release;
    r = simulate(s, c, t);
  }
  static const char* const units[NUM_UNITS] = {"identification", "selection", "step1", "step2", "distribution", "sort", "blend"};
  static const char* const streams[NUM_STREAMS] = {"records", "levels",    "geometry", "color", "lists",
                                                   "splats",  "projected", "pairs",    "frame"};
  nb::dict found, of_units, of_streams;
  for (int i = 0; i < NUM_UNITS; ++i) of_units[units[i]] = dict_of(r.units[i]);
  for (int i = 0; i < NUM_STREAMS; ++i) of_streams[streams[i]] = r.lines[i];
  nb::list spans;
  for (const Span& span : r.spans) spans.append(nb::make_tuple(units[span.unit], span.begin, span.end, span.items));
  found["units"] = of_units, found["lines"] = of_streams, found["spans"] = spans;
  found["records"] = dict_of(r.records), found["selected"] = dict_of(r.selected);
  found["front_cycles"] = r.front_cycles, found["cycles"] = r.cycles, found["dram_busy"] = r.dram_busy;
  found["activations"] = r.activations, found["row_hits"] = r.row_hits, found["deadlock"] = r.deadlock;
  found["rows_in"] = r.rows_in, found["survivors_out"] = r.survivors_out, found["pairs_out"] = r.pairs_out;
  found["tiles_out"] = r.tiles_out;
  return found;
}

// The cycle in which each kept cluster leaves the identification alone, where the input never waits and the output is taken in
// the cycles in which `ready` says so.
std::vector<std::pair<int64_t, int64_t>> identify(In<bool> kept, In<bool> ready, int interval, int latency, int selected_fifo) {
  Identifier identifier(interval, latency, selected_fifo);
  std::vector<std::pair<int64_t, int64_t>> found;
  const int64_t count = int64_t(kept.shape(0)), cycles = int64_t(ready.shape(0));
  int64_t next = 0;
  for (int64_t now = 0; now < cycles; ++now) {
    std::optional<Identifier::Visit> visit;
    if (next < count) visit = Identifier::Visit{next, kept.data()[next]};
    next += visit && identifier.has_room();
    const std::optional<int64_t> front = identifier.front();
    if (front && ready.data()[now]) found.emplace_back(now, *front);
    identifier.step(visit, ready.data()[now]);
  }
  return found;
}

// Cycles that the DRAM alone takes for lines at these addresses, in their order, all asked for at once.
int64_t replay(nb::dict settings, In<int64_t> addresses, In<bool> writes) {
  Dram dram(dram_of(Numbers(settings)));
  for (size_t i = 0; i < addresses.shape(0); ++i) dram.ask(writes.data()[i] ? PAIRS : GEOMETRY, addresses.data()[i], 1);
  int64_t now = 0;
  while (!dram.is_idle()) dram.step(now++);
  return now;
}

// LRU within each set; the youngest comes first. Without sets every access misses.
void cache_misses(In<int32_t> splats, In<int64_t> start, In<int64_t> order, int64_t sets, int ways, Out<int64_t> misses) {
  nb::gil_scoped_release release;
  std::vector<int32_t> lines(size_t(sets) * ways, -1);
  for (size_t i = 0; i < order.shape(0); ++i) {
    const int64_t tile = order.data()[i];
    int64_t missed = 0;
    for (int64_t at = start.data()[tile]; at < start.data()[tile + 1]; ++at) {
      const int32_t line = splats.data()[at];
      if (sets == 0) {
        ++missed;
        continue;
      }
      int32_t* set = &lines[size_t(line % sets) * ways];
      int way = 0;
      while (way < ways - 1 && set[way] != line) ++way;
      missed += set[way] != line;
      for (; way > 0; --way) set[way] = set[way - 1];
      set[0] = line;
    }
    misses.data()[i] = missed;
  }
}

}  // namespace

void bind_machine(nb::module_& m) {
  m.def("simulate_frame", &simulate_frame, nb::arg("settings"), nb::arg("clusters"), nb::arg("tiles"),
        "Step the accelerator through a frame; dictionaries of named numbers and columns (splatree/hardware/simulate.py).");
  m.def("identify", &identify, nb::arg("kept"), nb::arg("ready"), nb::arg("interval"), nb::arg("latency"),
        nb::arg("selected_fifo"), "Cycle and number of each cluster that leaves the identification alone.");
  m.def("replay", &replay, nb::arg("settings"), nb::arg("addresses"), nb::arg("writes"),
        "Cycles that the DRAM takes to read or write a line at each of the addresses.");
  m.def("cache_misses", &cache_misses, nb::arg("splats"), nb::arg("start"), nb::arg("order"), nb::arg("sets"), nb::arg("ways"),
        nb::arg("misses"), "Fill the lines that each tile misses in an LRU cache of so many sets and ways.");
}

}  // namespace splatree
