#include "core/cores.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#ifdef __linux__
#include <sched.h>
#endif

namespace sg {
namespace {

int whole_cores(long long quota, long long period) {
  if (quota <= 0 || period <= 0) return INT_MAX;
  return static_cast<int>(std::clamp<long long>(quota / period, 1, INT_MAX));
}

// The text of a small file, empty if it cannot be read. C's files: a module that brings its own C++ library, loaded
// beside others that bring theirs, may find a foreign locale behind a stream and crash.
std::string text_of(const std::string& path) {
  std::string text;
  if (std::FILE* file = std::fopen(path.c_str(), "re")) {
    char part[4096];
    while (const size_t size = std::fread(part, 1, sizeof(part), file)) text.append(part, size);
    std::fclose(file);
  }
  return text;
}

// Version 2: "250000 100000", or "max 100000" without a limit.
int quota_v2(const std::string& group) {
  long long quota, period;
  return std::sscanf(text_of(group + "/cpu.max").c_str(), "%lld %lld", &quota, &period) == 2
             ? whole_cores(quota, period)
             : INT_MAX;
}

// Version 1: two files, with -1 for no limit.
int quota_v1(const std::string& group) {
  const auto quota = std::atoll(text_of(group + "/cpu.cfs_quota_us").c_str());
  return whole_cores(quota, std::atoll(text_of(group + "/cpu.cfs_period_us").c_str()));
}

// The smallest quota from `group` up to the mount itself. A container may see its group's path on the host, while the
// mount shows only the group: folders that do not exist limit nothing.
template <typename Quota>
int smallest(const std::string& mount, std::string group, const Quota& quota) {
  int cores = quota(mount);
  for (; !group.empty(); group.resize(group.rfind('/'))) cores = std::min(cores, quota(mount + group));
  return cores;
}

bool lists_cpu(const std::string& controllers) { return ("," + controllers + ",").find(",cpu,") != std::string::npos; }

}  // namespace

#ifdef __linux__
// The kernel refuses a mask that is smaller than its own, so the mask grows until it fits.
int affinity_cores() {
  constexpr int kMaxCpus = 1 << 20;  // far beyond any machine: a larger mask would be refused for another reason
  for (int cpus = CPU_SETSIZE; cpus <= kMaxCpus; cpus *= 2) {
    std::vector<unsigned long> mask(CPU_ALLOC_SIZE(cpus) / sizeof(unsigned long));
    auto* set = reinterpret_cast<cpu_set_t*>(mask.data());
    if (sched_getaffinity(0, CPU_ALLOC_SIZE(cpus), set) == 0) return CPU_COUNT_S(CPU_ALLOC_SIZE(cpus), set);
    if (errno != EINVAL) break;
  }
  return 1;
}
#else
int affinity_cores() { return std::max(1, static_cast<int>(std::thread::hardware_concurrency())); }
#endif

int quota_cores(const std::string& root) {
  std::string v2, v1;  // the paths of the process's groups
  const std::string groups = text_of(root + "/proc/self/cgroup");
  for (size_t begin = 0, end; (end = groups.find('\n', begin)) != std::string::npos; begin = end + 1) {
    const std::string line = groups.substr(begin, end - begin);  // "number:controllers:path"; "0::path" for version 2
    const size_t first = line.find(':'), second = line.find(":/", first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1), group = line.substr(second + 1);
    if (controllers.empty()) v2 = group;
    if (lists_cpu(controllers)) v1 = group;
  }
  // Usual mount points; "unified" is version 2 next to version 1.
  const std::string mount = root + "/sys/fs/cgroup";
  return std::min({smallest(mount, v2, quota_v2), smallest(mount + "/unified", v2, quota_v2),
                   smallest(mount + "/cpu", v1, quota_v1), smallest(mount + "/cpu,cpuacct", v1, quota_v1)});
}

int available_cores() { return std::max(1, std::min(affinity_cores(), quota_cores(""))); }

}  // namespace sg
