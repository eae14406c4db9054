#include "cpu/runtime/processors.h"

#include <cmath>
#include <fstream>
#include <initializer_list>
#include <sstream>
#include <thread>

#ifdef __linux__
#include <sched.h>
#endif

namespace splatree {
namespace {

int allowed_processors() {
#ifdef __linux__
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
#endif
  const unsigned n = std::thread::hardware_concurrency();
  return n ? static_cast<int>(n) : 1;
}

double first_number(const std::string& path) {
  std::ifstream file(path);
  double number = 0;
  return file >> number ? number : 0;
}

// Processors that one group grants; 0 if it sets no limit, or does not exist here.
double granted(const std::string& folder) {
  std::ifstream file(folder + "/cpu.max");  // version 2: "max 100000" or "150000 100000"
  double quota = 0, period = 0;
  if (file >> quota >> period) return quota > 0 && period > 0 ? quota / period : 0;
  quota = first_number(folder + "/cpu.cfs_quota_us");  // version 1; -1: no limit
  period = first_number(folder + "/cpu.cfs_period_us");
  return quota > 0 && period > 0 ? quota / period : 0;
}

bool lists_cpu(const std::string& controllers) {
  std::istringstream names(controllers);
  for (std::string name; std::getline(names, name, ',');)
    if (name == "cpu") return true;
  return false;
}

}  // namespace

int quota_processors(const std::string& membership, const std::string& mount) {
  double least = 0;
  const auto limit = [&](double processors) {
    if (processors > 0 && (least == 0 || processors < least)) least = processors;
  };
  std::ifstream lines(membership);
  for (std::string line; std::getline(lines, line);) {  // "0::/path" of version 2, "4:cpu,cpuacct:/path" of version 1
    const size_t first = line.find(':'), second = line.find(':', first + 1);
    if (first == std::string::npos || second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    if (!controllers.empty() && !lists_cpu(controllers)) continue;
    const std::string hierarchy = controllers.empty() ? mount : mount + "/" + controllers;
    // A container may see its own group as the root, so groups on the way up that are not there are passed over.
    for (std::string path = line.substr(second + 1);;) {
      while (!path.empty() && path.back() == '/') path.pop_back();
      limit(granted(hierarchy + path));
      if (!controllers.empty()) limit(granted(mount + "/cpu" + path));
      if (path.empty()) break;
      path.erase(path.rfind('/') == std::string::npos ? 0 : path.rfind('/'));
    }
  }
  return static_cast<int>(std::ceil(least));
}

int hardware_threads() {
#ifdef __linux__
  static const int quota = quota_processors("/proc/self/cgroup", "/sys/fs/cgroup");
#else
  const int quota = 0;
#endif
  const int allowed = allowed_processors();
  return quota > 0 && quota < allowed ? quota : allowed;
}

}  // namespace splatree
