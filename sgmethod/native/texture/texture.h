// Texture from a seed (docs/format.md, version 2): noise that is generated, with strengths stored in the file.
//
// Octave o is noise on the samples of level o of the pyramid, added there and enlarged with the rest. Each sample
// depends only on its octave and coordinates, so that every region, thread and instruction set draws the same. It comes
// from a table without frequencies below the octave. Strengths are given at the centres of the picture's cells, and
// interpolated linearly between them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace sg {

constexpr int kTextureOctaves = 2;
constexpr int kTextureCell = 64;  // pixels of the picture along a side of a cell
constexpr int kTextureStrengths = 16;  // codes of a strength; 0 is none

// Number of cells along a side of so many pixels.
constexpr size_t texture_cells(int pixels) { return (static_cast<size_t>(pixels) + kTextureCell - 1) / kTextureCell; }

// Decodes codes [kTextureOctaves, rows, columns] of a picture of width x height pixels. used: number of bytes read.
// Throws std::runtime_error for data that no encoder writes.
std::vector<uint8_t> unpack_texture(const uint8_t* data, size_t size, int width, int height, size_t& used);

// Layout of the cells in the output.
struct TextureGrid {
  int columns, rows;
  double cell_x, cell_y;  // output pixels
  double x, y;  // the picture's corner, output pixels
  int shift;  // octave o is drawn on level o + shift, or not at all below level 0
};

// Strengths of a picture's texture, and the layout of its cells.
class Texture {
 public:
  // codes [kTextureOctaves, rows, columns]. Throws std::invalid_argument for invalid codes or grids.
  Texture(const uint8_t* codes, const TextureGrid& grid);

  // The highest level with noise; -1 for none.
  int top() const { return top_; }

 private:
  friend class TextureLayer;
  TextureGrid grid_;
  int top_ = -1;
  std::vector<float> strengths_;  // [kTextureOctaves, rows, columns], per unit of noise
};

// The noise of one level, for samples from (x, y) on, in whole strips. Sample (0, 0) begins at the picture's corner.
class TextureLayer {
 public:
  TextureLayer(const Texture& texture, int level, int x, int y, int columns, int rows);
  // Adds noise to some rows of a tile, accumulators [kTileHeight][3][kTileWidth]. x, y: the tile's first sample; isa:
  // see core/isa.h.
  void add(int isa, int x, int y, int first_row, int end_row, float* accumulators) const;

 private:
  int octave_, x_, y_, strips_;
  std::vector<int> cells_;  // the row of cells before each row, counted from the first row's
  std::vector<float> parts_;  // position of each row from there to the next row of cells, 0 to 1
  std::vector<float> strengths_;  // [rows of cells, columns]; empty without noise
  std::vector<uint8_t> busy_;  // [rows of cells, strips]: whether any strength is above 0
};

}  // namespace sg
