// How many processor cores this process may use.
#pragma once

#include <string>

namespace sg {

// Both of what follows together; at least 1.
int available_cores();

// The cores that the process may run on, however many the machine has.
int affinity_cores();

// The cores that the smallest quota among the process's control group and those above it allows: at least 1, and
// INT_MAX where there is none. `root` is the folder that holds proc/ and sys/.
int quota_cores(const std::string& root);

}  // namespace sg
