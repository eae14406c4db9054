// A level of growth by pairs, in place: of two that become one the first keeps its row, so a round touches what it merges and
// those who had it among their candidates. Rows keep their places until the level ends.
//
// Cost: a record for each row, 64 bytes and 0.1 µs; a third of a microsecond for each row whose partner is to be found; 2 µs a
// pair.
#include "cpu/build/level.h"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <vector>

#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr int64_t GRAIN = 1 << 12;  // rows that a thread takes at a time

class Level {
 public:
  explicit Level(const LevelJob& job)
      : job_(job), records_(allocate<PairRecord>(job.n)), is_new_(allocate<uint8_t>(job.n)), num_left_(job.n) {
    std::memset(is_new_.get(), 0, job.n);
    parallel_ranges(job.n, GRAIN, job.threads, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) read_record(row);
    });
  }

  void find_partners() const {
    parallel_ranges(job_.n, GRAIN, job_.threads, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) find_stale(row);
    });
  }

  int64_t merge() {
    std::iota(job_.row_from_row, job_.row_from_row + job_.n, 0);
    for (int64_t row = 0; row < job_.n; ++row) num_left_ -= job_.is_frozen[row];
    while (num_left_ > job_.limits.num_enough) {
      const int64_t most = static_cast<int64_t>(job_.limits.round_share * static_cast<double>(num_left_)) + 1;
      Scratch<KeyRow> listed;
      const int64_t num_listed = list_allowed(listed);
      const std::vector<FoundPair> pairs =
          cheapest_pairs(listed, num_listed, job_.partners.rows, most, is_new_.get(), job_.threads);
      if (!pairs.empty()) merge_round(pairs);
      if (static_cast<double>(pairs.size()) < job_.limits.last_share * static_cast<double>(num_left_)) break;
    }
    // A row became part of an earlier one, which may have become part of one before it.
    int32_t* to = job_.row_from_row;
    for (int64_t row = 0; row < job_.n; ++row) to[row] = to[to[row]];
    return num_left_;
  }

 private:
  bool is_left(int64_t row) const { return job_.row_from_row[row] == row; }

  bool is_frozen(int64_t row) const { return job_.is_frozen[row]; }

  void read_record(int64_t row) const {
    PairJob job{};
    job.means = job_.means, job.quats = job_.quats, job.log_scales = job_.log_scales;
    job.logit_opacities = job_.logit_opacities, job.sh = job_.sh, job.k = job_.rules.k;
    job.weights = job_.weights, job.visibilities = job_.visibilities;
    job.dilation = job_.limits.dilation;
    records_[row] = record_of(job, row);
  }

  void find_stale(int64_t row) const {
    if (job_.partners.states[row] == STALE) find_partner(records_.get(), row, job_.limits.dilation, job_.partners);
  }

  bool may_merge(int64_t row) const {
    const PartnerColumns& partners = job_.partners;
    const LevelLimits& limits = job_.limits;
    const bool is_cheap = partners.costs[row] <= limits.cost;
    if (partners.rows[row] < 0 || is_frozen(row) || is_frozen(partners.rows[row])) return false;
    if (!(is_cheap || partners.least_sigmas[row] <= limits.small_sigma)) return false;
    const float sigma = merged_sigma(records_[row], records_[partners.rows[row]], limits.dilation);
    return (is_cheap && sigma <= limits.sigma) || sigma <= limits.small_sigma;
  }

  // Finds the partners that are stale, and lists the rows that may merge with theirs; returns how many.
  int64_t list_allowed(Scratch<KeyRow>& listed) const {
    std::vector<std::vector<KeyRow>> parts((job_.n + GRAIN - 1) / GRAIN);
    parallel_ranges(job_.n, GRAIN, job_.threads, [&](int64_t begin, int64_t end) {
      std::vector<KeyRow>& part = parts[begin / GRAIN];
      for (int64_t row = begin; row < end; ++row) {
        if (!is_left(row)) continue;
        find_stale(row);
        if (may_merge(row)) part.push_back(by_cost(job_.partners.costs[row], row));
      }
    });
    int64_t count = 0;
    for (const std::vector<KeyRow>& part : parts) count += int64_t(part.size());
    listed = allocate<KeyRow>(count);
    KeyRow* next = listed.get();
    for (const std::vector<KeyRow>& part : parts) next = std::copy(part.begin(), part.end(), next);
    return count;
  }

  // The first row of each pair becomes what both become; its second row is left no more.
  void merge_round(const std::vector<FoundPair>& pairs) {
    const int64_t num_pairs = int64_t(pairs.size());
    std::vector<int32_t> members(2 * num_pairs);
    for (int64_t i = 0; i < num_pairs; ++i) {
      members[2 * i] = std::min(pairs[i].finder, pairs[i].partner);
      members[2 * i + 1] = std::max(pairs[i].finder, pairs[i].partner);
      job_.row_from_row[members[2 * i + 1]] = members[2 * i];
    }
    merge_columns(pairs, members);

    const Moves moves{job_.row_from_row, is_new_.get()};
    parallel_ranges(num_pairs, GRAIN, job_.threads, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        read_record(members[2 * i]);
        follow_moves(moves, job_.means, members[2 * i], members[2 * i + 1], job_.partners);
      }
    });
    parallel_ranges(job_.n, GRAIN, job_.threads, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row)
        if (is_left(row) && !is_new_[row]) follow_moves(moves, job_.means, row, -1, job_.partners);
    });
    for (const int32_t row : members) is_new_[row] = 0;
    num_left_ -= num_pairs;
  }

  void merge_columns(const std::vector<FoundPair>& pairs, const std::vector<int32_t>& members) const {
    const int64_t g = int64_t(pairs.size()), width = 3 * job_.rules.k;
    std::vector<int64_t> start(g + 1);
    std::vector<int32_t> first(g);
    std::vector<float> opacities(g);
    for (int64_t i = 0; i < g; ++i) {
      start[i + 1] = 2 * (i + 1);
      first[i] = members[2 * i];
      const float fitted = job_.partners.opacities[pairs[i].finder];
      opacities[i] = fitted < job_.limits.saturated ? fitted : 0;
    }
    const Scratch<float> merged = allocate<float>(g * (11 + width));
    MergeJob job = job_.rules;
    job.num_groups = g;
    job.in = {job_.means, job_.quats, job_.log_scales, job_.logit_opacities, job_.sh};
    job.weights = job_.weights;
    job.start = start.data(), job.rows = members.data(), job.representatives = first.data();
    job.opacities = opacities.data();
    job.means = merged.get(), job.quats = job.means + 3 * g, job.log_scales = job.quats + 4 * g;
    job.logit_opacities = job.log_scales + 3 * g, job.sh = job.logit_opacities + g;
    job.threads = job_.threads;
    splatree::merge(job);

    for (int64_t i = 0; i < g; ++i) {
      const int64_t row = first[i], other = members[2 * i + 1];
      std::copy_n(job.means + 3 * i, 3, job_.means + 3 * row);
      std::copy_n(job.quats + 4 * i, 4, job_.quats + 4 * row);
      std::copy_n(job.log_scales + 3 * i, 3, job_.log_scales + 3 * row);
      job_.logit_opacities[row] = job.logit_opacities[i];
      std::copy_n(job.sh + width * i, width, job_.sh + width * row);
      const float weight = job_.weights[row] + job_.weights[other], share = job_.weights[other] / weight;
      job_.visibilities[row] += share * (job_.visibilities[other] - job_.visibilities[row]);
      job_.weights[row] = weight;
    }
  }

  const LevelJob& job_;
  Scratch<PairRecord> records_;
  Scratch<uint8_t> is_new_;  // rows of the pairs of this round
  int64_t num_left_;
};

}  // namespace

int64_t merge_level(const LevelJob& job) { return Level(job).merge(); }

void find_partners(const LevelJob& job) { Level(job).find_partners(); }

}  // namespace splatree
