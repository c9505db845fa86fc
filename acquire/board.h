// Calibration boards: chessboards and ChArUco boards (Garrido-Jurado et al., Pattern Recognition 2014), what their
// corners are, where a photograph shows them, and how they are printed.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"
#include "base/transform.h"

namespace srf {

/// The board's own space, in the board's units: origin at its centre, x to the right, y up, z out of its printed side.
struct BoardSpace;

struct Board {
  enum class Kind { chessboard, charuco };
  Kind kind = Kind::chessboard;
  int columns = 0, rows = 0;  ///< inner corners of a chessboard; squares of a ChArUco board
  double square = 0;          ///< side of a square, mm
  double marker = 0;          ///< ChArUco: side of a marker, mm
  std::string dictionary;     ///< ChArUco: as OpenCV names it without DICT_, e.g. "5X5_100"

  int squareColumns() const { return kind == Kind::chessboard ? columns + 1 : columns; }
  int squareRows() const { return kind == Kind::chessboard ? rows + 1 : rows; }
  int cornerColumns() const { return squareColumns() - 1; }
  int cornerRows() const { return squareRows() - 1; }
  int cornerCount() const { return cornerColumns() * cornerRows(); }
  /// Corner `i`, counted row by row from the top left, in units of `millimetre` (0.001: metres).
  Point<BoardSpace> corner(int i, double millimetre) const;
  /// Whether the board looks the same when it is turned by half a turn, so that its corners cannot be told apart.
  bool turnsIntoItself() const;
  /// The option's text: "chessboard:9x6:25mm", "charuco:8x11:20mm:15mm:5X5_100".
  std::string text() const;
};

/// Parses what `text` writes ("9x6:25mm" is a chessboard; mm, cm, m; a ChArUco board's marker and dictionary may be
/// left out: 3/4 of the square, 5X5_100). Throws usage that says the form.
Board parseBoard(const std::string& text);

/// What one photograph shows of a board.
struct BoardCorners {
  std::vector<int> ids;      ///< corner numbers, ascending
  std::vector<Vec2> pixels;  ///< of the same length; pixel centres at +0.5
};

/// A photograph as findBoard wants it: luminance with the sRGB curve, 8 bits; a float file is exposed so that 1 % of it
/// is white.
Image8 greyPhotograph(const std::filesystem::path& file);

/// Corners to sub-pixel, or nothing where the board is not there. `grey`: one channel of display values. Throws
/// bad_input where a ChArUco board of an even number of rows has the layout of OpenCV before 4.6 (`file` names it).
std::optional<BoardCorners> findBoard(const Board& board, const Image8& grey, const std::filesystem::path& file);

/// The printed board as dark rectangles on white, in mm from the top left of its first square; light ones lie on dark
/// ones, later ones on top.
struct PrintedRectangle {
  double x = 0, y = 0, width = 0, height = 0;
  bool dark = true;
};
std::vector<PrintedRectangle> printedBoard(const Board& board);
/// Writes the board at its true size as .svg or .pdf by the file's ending, with its text and a ruler of 100 mm (or the
/// longest that fits). Throws usage for another ending, and for a ChArUco board of an even number of rows.
void printBoard(const Board& board, const std::filesystem::path& file);

}  // namespace srf
