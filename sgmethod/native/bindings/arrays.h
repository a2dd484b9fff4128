// Types of Python's arrays for the kernels: C-contiguous, in the CPU's memory.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <climits>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/gaussians.h"
#include "texture/texture.h"

namespace nb = nanobind;

// Inputs of another type or layout are converted. Arguments of types that end in Out are bound with noconvert(),
// because results would be written to the converted copy and be lost.
template <int Columns>
using Rows = nb::ndarray<const float, nb::shape<-1, Columns>, nb::c_contig, nb::device::cpu>;
template <int Columns>
using RowsOut = nb::ndarray<float, nb::shape<-1, Columns>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<const float, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Image = nb::ndarray<const float, nb::shape<3, -1, -1>, nb::c_contig, nb::device::cpu>;
using ImageOut = nb::ndarray<float, nb::shape<3, -1, -1>, nb::c_contig, nb::device::cpu>;
using Plane = nb::ndarray<const float, nb::shape<-1, -1>, nb::c_contig, nb::device::cpu>;
using PlaneOut = nb::ndarray<float, nb::shape<-1, -1>, nb::c_contig, nb::device::cpu>;
using MarksOut = nb::ndarray<uint8_t, nb::shape<-1, -1>, nb::c_contig, nb::device::cpu>;
using Target = nb::ndarray<const int16_t, nb::shape<3, -1, -1>, nb::c_contig, nb::device::cpu>;
using Codes = nb::ndarray<const uint8_t, nb::shape<-1, -1, -1>, nb::c_contig, nb::device::cpu>;
using Visibility = nb::ndarray<const int16_t, nb::shape<-1, -1>, nb::c_contig, nb::device::cpu>;
using Bytes = nb::ndarray<const uint8_t, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Pixels = nb::ndarray<const uint8_t, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;
using BytesOut = nb::ndarray<uint8_t, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;

inline void require(bool condition, const char* message) {
  if (!condition) throw nb::value_error(message);
}

// The number of Gaussians, which is the number of rows of every array.
template <typename First, typename... Others>
int gaussians(const First& first, const Others&... others) {
  require(((others.shape(0) == first.shape(0)) && ...), "one row per Gaussian");
  require(first.shape(0) <= INT_MAX, "too many Gaussians");
  return static_cast<int>(first.shape(0));
}

inline sg::ConstGaussians rows(const Rows<2>& means, const Rows<3>& factors, const Rows<3>& colors) {
  return {means.data(), factors.data(), colors.data()};
}
inline sg::MutableGaussians rows(const RowsOut<2>& means, const RowsOut<3>& factors, const RowsOut<3>& colors) {
  return {means.data(), factors.data(), colors.data()};
}

template <typename Array>
int side(const Array& image, int axis) {
  require(image.shape(axis) <= INT_MAX, "the image is too large");
  return static_cast<int>(image.shape(axis));
}

// Requires an image [3, height, width].
template <typename Array>
void require_size(const Array& image, int width, int height) {
  require(side(image, 1) == height && side(image, 2) == width, "image has another size");
}

// An image's visibility [height, width], or null for None.
inline const int16_t* values_of(const std::optional<Visibility>& visibility, int width, int height) {
  if (!visibility) return nullptr;
  require(side(*visibility, 0) == height && side(*visibility, 1) == width, "the visibility has another size");
  return visibility->data();
}

// A NumPy array of this shape that owns the values.
template <typename Array, typename T>
Array own(std::vector<T>&& values, std::initializer_list<size_t> shape) {
  auto kept = std::make_unique<std::vector<T>>(std::move(values));
  nb::capsule owner(kept.get(), [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return Array(kept.release()->data(), shape, owner);
}

// Rows of `Columns` floats.
template <size_t Columns>
auto own_rows(std::vector<float>&& values) {
  const size_t rows = values.size() / Columns;
  return own<nb::ndarray<nb::numpy, float, nb::shape<-1, Columns>>>(std::move(values), {rows, Columns});
}

// A texture that a Rasterization keeps, or none for None.
inline std::shared_ptr<const sg::Texture> shared(const sg::Texture* texture) {
  return texture == nullptr ? nullptr : std::make_shared<const sg::Texture>(*texture);
}

// Each adds a folder's classes and functions to the module.
void bind_raster(nb::module_& m);
void bind_fit(nb::module_& m);
void bind_rd(nb::module_& m);
