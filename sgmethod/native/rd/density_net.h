// The networks of density_map.h: logarithms in sixteenths of an octave, weights in 1/64 (docs/format.md).
// Made by `python -m tests.bitstream.train`, which names the photographs.
#pragma once

#include <cstdint>

namespace sg {

constexpr int kClassGroups = 14, kMapUnits = 4, kOwnUnits = 3;
constexpr int16_t kMapBase[14] = {
    -6, -20, -22, -4, -5, -13, -8, -8, 2, 1, -2, -1, 0, -2};
constexpr int16_t kMapBias[14][4] = {
    {68, -10, -8, 59}, {125, 19, 6, 102}, {150, 21, 14, 135}, {59, -8, 14, 85}, {62, -9, 17, 98}, {12, -7, 23, 126},
    {172, -6, 26, 7}, {149, -2, 25, -22}, {-34, 2, 27, 52}, {79, 0, 11, -19}, {28, -4, 18, -17}, {51, -5, 12, -2},
    {-6, -11, 4, 10}, {-7, -60, -32, 48}};
constexpr int16_t kMapWeights[4][4] = {
    {64, 23, -41, 10}, {-1, -5, 0, -64}, {-1, 17, -12, -64}, {64, 1, -24, 1}};
constexpr int16_t kMapOut[4] = {
    10, -29, 31, 18};
constexpr int16_t kOwnBias[14][3] = {
    {8, -21, -23}, {-28, 16, -18}, {-16, 14, 50}, {-14, 25, 69}, {-14, 18, 66}, {-12, 15, 57}, {-10, 5, 54}, {-15,
    -5, 36}, {-17, -16, 36}, {-12, -6, -27}, {-19, -14, -26}, {-29, -30, -35}, {-33, -30, -44}, {-41, -30, -36}};
constexpr int16_t kOwnWeights[3][3] = {
    {-33, -64, 12}, {64, 16, 27}, {-20, -64, 21}};
constexpr int16_t kOwnOut[3] = {
    -69, 19, -19};

}  // namespace sg
