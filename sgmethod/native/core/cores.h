// Number of processor cores this process may use.
#pragma once

#include <string>

namespace sg {

// The smaller of affinity_cores() and quota_cores(); at least 1.
int available_cores();

// Cores in the process's affinity mask.
int affinity_cores();

// Cores allowed by the smallest quota of the process's control group and its ancestors: at least 1, INT_MAX without a
// quota. root: the folder that contains proc/ and sys/.
int quota_cores(const std::string& root);

}  // namespace sg
