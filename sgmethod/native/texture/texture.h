// Texture from a seed (docs/format.md, version 2): noise that the file does not hold, with the strength that it does.
//
// Octave o is noise on the samples of level o of the pyramid, added there and enlarged with all else. Each sample is a
// function of its octave and place alone, so that any region, thread and instruction set draws the same. It is banded:
// frequencies below its octave are taken out of it, once for a table that holds all samples. Strengths are given for the middles of the picture's cells; between them they go straight.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace sg {

constexpr int kTextureOctaves = 2;
constexpr int kTextureCell = 64;      // pixels of the picture along a side of a cell
constexpr int kTextureStrengths = 16; // codes of a strength; 0 is none

// The number of cells along a side, given in pixels.
constexpr size_t texture_cells(int pixels) { return (static_cast<size_t>(pixels) + kTextureCell - 1) / kTextureCell; }

// The codes [kTextureOctaves, rows, columns] that a file says of a picture, given in pixels; used: the bytes that say it.
// Throws std::runtime_error for what no encoder writes.
std::vector<uint8_t> unpack_texture(const uint8_t* data, size_t size, int width, int height, size_t& used);

// Where the cells lie in what is drawn.
struct TextureGrid {
  int columns, rows;
  double cell_x, cell_y;  // output pixels
  double x, y;            // of the picture's corner, output pixels
  int shift;              // octave o is drawn on level o + shift; on none below level 0
};

// The codes of a picture, and where their cells lie.
class Texture {
 public:
  // codes [kTextureOctaves, rows, columns]. Throws std::invalid_argument for codes or grids that cannot be.
  Texture(const uint8_t* codes, const TextureGrid& grid);

  // The highest level that noise is added to; -1 if none is.
  int top() const { return top_; }

 private:
  friend class TextureLayer;
  TextureGrid grid_;
  int top_ = -1;
  std::vector<float> strengths_;  // [kTextureOctaves, rows, columns], of the noise's unit
};

// The noise of one level, over columns, in whole strips, and rows of its samples from (x, y) on. There 0 is the
// sample whose corner is that of the picture.
class TextureLayer {
 public:
  TextureLayer(const Texture& texture, int level, int x, int y, int columns, int rows);
  // Adds it to some rows of a tile, accumulators [kTileHeight][3][kTileWidth]. x, y: of the tile's first sample. isa:
  // core/isa.h.
  void add(int isa, int x, int y, int first_row, int end_row, float* accumulators) const;

 private:
  int octave_, x_, y_, strips_;
  std::vector<int> cells_;        // of each row: the row of cells before it, counted from that of the first
  std::vector<float> parts_;      // of each row: the part of the way to the next row of cells
  std::vector<float> strengths_;  // [rows of cells, columns]; empty where there is no noise
  std::vector<uint8_t> busy_;     // [rows of cells, strips]: whether any of them is above 0
};

}  // namespace sg
