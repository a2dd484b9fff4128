// The networks of structure.h: logarithms in sixteenths of an octave, weights in 1/64 (docs/format.md). Made by
// `python -m benchmarks.coder`, which names the photographs.
#pragma once

#include <cstdint>

namespace sg {

constexpr int kClassGroups = 14, kMapUnits = 4, kOwnUnits = 3;
constexpr int16_t kMapBase[14] = {-4, -6, -12, -4, -10, -8, -4, 2, 2, 2, 2, 0, 1, -2};
constexpr int16_t kMapBias[14][4] = {{23, 43, -90, 92},  {62, 106, -82, 129}, {77, 140, -79, 178}, {39, 124, -59, 115},
                                     {6, 41, -69, 132},  {30, 26, -81, 138},  {21, 32, -85, 99},   {60, 45, -71, 27},
                                     {23, 50, -86, 16},  {16, 42, -75, 20},   {-13, 46, -81, -2},  {-6, 41, -73, 2},
                                     {-52, 38, -83, -3}, {-84, -103, -87, 9}};
constexpr int16_t kMapWeights[4][4] = {{47, 64, -18, -6}, {2, -64, 1, 8}, {-12, 41, 28, -64}, {64, 29, -56, -11}};
constexpr int16_t kMapOut[4] = {7, -10, 2, 11};
constexpr int16_t kOwnBias[14][3] = {{-27, 77, -13}, {-28, 58, 18},  {-9, 53, 23},   {-9, 44, 29},  {-5, 41, 24},
                                     {-5, 53, 15},   {-6, 36, 11},   {-7, 57, 2},    {-11, 34, -1}, {-15, 35, -13},
                                     {-23, 25, -15}, {-32, 24, -20}, {-33, 29, -19}, {-42, 29, -19}};
constexpr int16_t kOwnWeights[3][3] = {{-25, -64, 1}, {-10, 2, 64}, {54, 64, 29}};
constexpr int16_t kOwnOut[3] = {-66, -11, 23};

}  // namespace sg
