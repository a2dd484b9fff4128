// Counting cores: the process's control group and those above it, in a folder that looks like a system.
#include "core/cores.h"

#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <climits>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "check.h"

namespace {

int pretended_cpus = 0;  // of the machine; 0 for those it has

// A folder with proc/ and sys/ that goes with the object.
class System {
 public:
  System() {
    std::string pattern = (std::filesystem::temp_directory_path() / "sg-cores-XXXXXX").string();
    root_ = mkdtemp(pattern.data());
  }
  ~System() { std::filesystem::remove_all(root_); }

  System& file(const std::string& name, const std::string& text) {
    const std::filesystem::path path = root_ / name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path) << text;
    return *this;
  }
  // The process's groups, and a limit of one folder of groups.
  System& groups(const std::string& lines) { return file("proc/self/cgroup", lines); }
  System& v2(const std::string& group, const std::string& text) {
    return file("sys/fs/cgroup" + group + "/cpu.max", text);
  }
  System& v1(const std::string& folder, const std::string& quota, const std::string& period) {
    file("sys/fs/cgroup/" + folder + "/cpu.cfs_period_us", period);
    return file("sys/fs/cgroup/" + folder + "/cpu.cfs_quota_us", quota);
  }
  int cores() const { return sg::quota_cores(root_.string()); }

 private:
  std::filesystem::path root_;
};

}  // namespace

#ifdef __GLIBC__
#define SG_DECLARED noexcept
#else
#define SG_DECLARED
#endif

// Takes the place of the C library's: a machine of many processors refuses a mask that is too small for them.
extern "C" int sched_getaffinity(pid_t process, size_t size, cpu_set_t* mask) SG_DECLARED {
  if (pretended_cpus == 0) return syscall(SYS_sched_getaffinity, process, size, mask) < 0 ? -1 : 0;
  if (8 * size < static_cast<size_t>(pretended_cpus)) {
    errno = EINVAL;
    return -1;
  }
  for (int cpu = 0; cpu < pretended_cpus; ++cpu) CPU_SET_S(cpu, size, mask);
  return 0;
}

TEST(cores_of_a_machine_with_thousands_of_them) {
  for (const int cpus : {1, 1024, 1025, 5000}) {
    pretended_cpus = cpus;
    CHECK(sg::affinity_cores() == cpus);
  }
  pretended_cpus = 0;
}

TEST(cores_without_control_groups) { CHECK(System().cores() == INT_MAX); }

TEST(cores_of_a_container) {
  CHECK(System().v2("", "max 100000\n").cores() == INT_MAX);
  CHECK(System().v2("", "250000 100000\n").cores() == 2);
  CHECK(System().v2("", "50000 100000\n").cores() == 1);
  CHECK(System().v2("", "?").cores() == INT_MAX);
  CHECK(System().v2("", "").cores() == INT_MAX);
  CHECK(System().v2("", "300000").cores() == INT_MAX);
  CHECK(System().v2("", "300000 0").cores() == INT_MAX);
  CHECK(System().v2("", "9223372036854775807 1").cores() == INT_MAX);
  CHECK(System().v2("", "99999999999999999999999 1").cores() == INT_MAX);
}

TEST(cores_of_the_own_group_and_those_above_it) {
  CHECK(System().groups("0::/a/b\n").v2("/a/b", "300000 100000").cores() == 3);
  CHECK(System().groups("0::/a/b\n").v2("/a/b", "max 100000").v2("/a", "200000 100000").cores() == 2);
  CHECK(System().groups("0::/a/b\n").v2("/a/b", "300000 100000").v2("/a", "500000 100000").cores() == 3);
  CHECK(System().groups("0::/a/b\n").v2("/a/b/c", "100000 100000").v2("/other", "100000 100000").cores() == INT_MAX);
  CHECK(System().groups("0::/\n").v2("", "400000 100000").cores() == 4);
  CHECK(System().groups("0::/on/the/host\n").v2("", "400000 100000").cores() == 4);
}

TEST(cores_of_version_1) {
  CHECK(System().v1("cpu", "-1", "100000").cores() == INT_MAX);
  CHECK(System().v1("cpu,cpuacct", "350000", "100000").cores() == 3);
  const std::string period = "100000";
  System above, other, both;
  above.groups("7:memory:/m\n4:cpu,cpuacct:/a/b\n").v1("cpu/a/b", "-1", period).v1("cpu/a", "200000", period);
  CHECK(above.cores() == 2);
  other.groups("4:cpuset:/a\n3:cpu:/b\n").v1("cpu/a", "100000", period).v1("cpu/b", "500000", period);
  CHECK(other.cores() == 5);
  both.groups("4:cpu:/a\n0::/b\n").v1("cpu/a", "600000", period).v2("/unified/b", "500000 100000");
  CHECK(both.cores() == 5);
}

TEST(cores_with_a_list_of_groups_that_is_none) {
  CHECK(System().groups("nonsense\n::\n0::\n0::relative\n\n").v2("", "200000 100000").cores() == 2);
}

TEST(cores_of_this_process) {
  CHECK(sg::available_cores() >= 1);
  CHECK(sg::available_cores() <= sg::affinity_cores());
}
