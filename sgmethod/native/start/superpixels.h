// Superpixels by SLIC (R. Achanta et al., "SLIC superpixels compared to state-of-the-art superpixel methods", 2012).
//
// Labels equal those of cv2.ximgproc, which not every package of OpenCV has: its SLIC with ten iterations, then
// enforceLabelConnectivity(). Each sum therefore has that module's order.
#pragma once

#include <cstdint>
#include <vector>

namespace sg {

// Labels [height, width], from 0, of an image [3, height, width] in CIELAB. side: of a region, in pixels, at most the
// image's shorter side; compactness: weight of distance against colour.
std::vector<int32_t> superpixels(const float* lab, int width, int height, int side, float compactness);

}  // namespace sg
