// How many processors this process may use.
#pragma once
#include <string>

namespace splatree {

// The processors that the process is allowed on (affinity), but no more than its share of processor time (the quota of its
// control group, as containers have one). At least 1. The quota is read once, the affinity at each call.
int hardware_threads();

// Processors' worth of time that Linux control groups grant, rounded up; 0 if there is no limit. `membership` is the file
// /proc/self/cgroup, `mount` the folder /sys/fs/cgroup. Version 1 and 2 are read, from the group of the process up to the root.
int quota_processors(const std::string& membership, const std::string& mount);

}  // namespace splatree
