// Rules of merging from Python, for the two stages that merge.
#pragma once
#include "cpu/build/merge.h"
#include "cpu/runtime/arrays.h"

namespace splatree {

// A job with the rules of MergeOptions (resolved), and nothing to merge.
MergeJob merge_job_of(nb::handle options);

}  // namespace splatree
