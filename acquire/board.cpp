#include "acquire/board.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "base/check.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/json.h"
#include "base/text.h"

namespace srf {
namespace {

constexpr const char* kDictionaries[] = {"4X4_50",  "4X4_100",  "4X4_250", "4X4_1000", "5X5_50",        "5X5_100",
                                         "5X5_250", "5X5_1000", "6X6_50",  "6X6_100",  "6X6_250",       "6X6_1000",
                                         "7X7_50",  "7X7_100",  "7X7_250", "7X7_1000", "ARUCO_ORIGINAL"};

Error notABoard(const std::string& text, const std::string& what) {
  return {ErrorKind::usage,
          what +
              "; write inner corners and square, '9x6:25mm', or a ChArUco board's squares, square, marker and "
              "dictionary, 'charuco:8x11:20mm:15mm:5X5_100'",
          "board '" + text + "'"};
}

double parseLength(const std::string& text, const std::string& word) {
  std::size_t used = 0;
  double value = 0;
  try {
    value = std::stod(word, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  const std::string unit = word.substr(used);
  const double millimetres = unit == "mm" ? 1 : unit == "cm" ? 10 : unit == "m" ? 1000 : 0;
  if (used == 0 || !(value > 0) || !std::isfinite(value) || millimetres == 0)
    throw notABoard(text, "'" + word + "' is not a length with its unit, e.g. 25mm");
  return value * millimetres;
}

cv::Ptr<cv::aruco::Dictionary> dictionaryOf(const Board& board) {
  const auto* found = std::find(std::begin(kDictionaries), std::end(kDictionaries), board.dictionary);
  return cv::aruco::getPredefinedDictionary(static_cast<int>(found - std::begin(kDictionaries)));
}

/// Where the markers are, by number: squares that are white, row by row. OpenCV 4.6 has a dark square at the top left
/// always; before it the bottom left square was the dark one, which differs where the number of rows is even.
struct MarkerSquare {
  int column, row;
};
std::vector<MarkerSquare> markerSquares(const Board& board, bool before_4_6) {
  const int dark = before_4_6 ? (board.rows - 1) % 2 : 0;  // parity of the dark squares
  std::vector<MarkerSquare> squares;
  for (int row = 0; row < board.rows; ++row)
    for (int column = 0; column < board.columns; ++column)
      if ((row + column) % 2 != dark) squares.push_back({column, row});
  return squares;
}

/// The share of the detected markers' corners that fit one projective map of the board.
double shareThatFits(const Board& board, const std::vector<MarkerSquare>& squares,
                     const std::vector<std::vector<cv::Point2f>>& corners, const std::vector<int>& ids) {
  std::vector<cv::Point2f> flat, seen;
  const double inset = 0.5 * (board.square - board.marker);
  double pixels = 0;  // a marker's side
  for (std::size_t k = 0; k < ids.size(); ++k) {
    if (ids[k] < 0 || ids[k] >= static_cast<int>(squares.size())) continue;
    const double x = squares[ids[k]].column * board.square + inset, y = squares[ids[k]].row * board.square + inset;
    for (int c = 0; c < 4; ++c) {
      flat.emplace_back(static_cast<float>(x + (c == 1 || c == 2 ? board.marker : 0)),
                        static_cast<float>(y + (c >= 2 ? board.marker : 0)));
      seen.push_back(corners[k][c]);
    }
    pixels += cv::norm(corners[k][0] - corners[k][2]) / 1.5;
  }
  if (flat.size() < 8) return 0;
  std::vector<unsigned char> inlier;
  const cv::Mat map = cv::findHomography(flat, seen, cv::RANSAC, 0.1 * pixels / (flat.size() / 4.0), inlier);
  if (map.empty()) return 0;
  return static_cast<double>(std::count(inlier.begin(), inlier.end(), 1)) / static_cast<double>(inlier.size());
}

std::optional<BoardCorners> findCharuco(const Board& board, const cv::Mat& grey, const std::filesystem::path& file) {
  const auto layout = cv::aruco::CharucoBoard::create(board.columns, board.rows, static_cast<float>(board.square),
                                                      static_cast<float>(board.marker), dictionaryOf(board));
  std::vector<std::vector<cv::Point2f>> markers, rejected;
  std::vector<int> ids;
  cv::aruco::detectMarkers(grey, layout->dictionary, markers, ids, cv::aruco::DetectorParameters::create(), rejected);
  if (ids.size() < 2) return std::nullopt;
  if (board.rows % 2 == 0) {
    const double now = shareThatFits(board, markerSquares(board, false), markers, ids),
                 before = shareThatFits(board, markerSquares(board, true), markers, ids);
    // Of an odd number of columns n all but one of n markers fit the wrong layout too, moved by a square.
    if (before > 0.7 && before > now + 0.4 / board.columns)
      throw badInput(file.string(),
                     "the ChArUco board has a marker in its top left square: with an even number of rows (" +
                         std::to_string(board.rows) +
                         ") that is the layout of OpenCV before 4.6, which the installed version does not read and "
                         "whose corners would be misplaced; print a board with an odd number of rows (srf calibrate "
                         "--print-board), which both versions lay out alike");
  }
  cv::Mat found, found_ids;
  if (cv::aruco::interpolateCornersCharuco(markers, ids, grey, layout, found, found_ids) < 4) return std::nullopt;
  BoardCorners corners;
  for (int i = 0; i < found_ids.rows; ++i) {
    corners.ids.push_back(found_ids.at<int>(i));
    const auto p = found.at<cv::Point2f>(i);
    corners.pixels.push_back({p.x, p.y});  // unlike chessboards' these count from the first pixel's corner already
  }
  return corners;
}

double meanAround(const cv::Mat& grey, const cv::Point2f& p) {
  const int x = std::clamp(static_cast<int>(std::lround(p.x)), 1, grey.cols - 2),
            y = std::clamp(static_cast<int>(std::lround(p.y)), 1, grey.rows - 2);
  return cv::mean(grey(cv::Rect(x - 1, y - 1, 3, 3)))[0];
}

// OpenCV names the corners from either end, as they lie in the picture. A board seen from its front keeps its hand;
// the square between the first four inner corners is dark (the square at the board's corner is, and this one lies
// diagonally to it).
void orderCorners(const Board& board, const cv::Mat& grey, std::vector<cv::Point2f>& corners) {
  const int n = board.columns, m = board.rows;
  const auto at = [&](int column, int row) { return corners[static_cast<std::size_t>(row * n + column)]; };
  const cv::Point2f along = at(n - 1, 0) - at(0, 0), down = at(0, m - 1) - at(0, 0);
  if (along.x * down.y - along.y * down.x < 0)
    for (int row = 0; row < m; ++row) std::reverse(corners.begin() + row * n, corners.begin() + (row + 1) * n);
  const auto square = [&](int column, int row) {
    return meanAround(grey,
                      0.25F * (at(column, row) + at(column + 1, row) + at(column, row + 1) + at(column + 1, row + 1)));
  };
  if (!board.turnsIntoItself() && square(0, 0) > square(n - 2, m - 2)) std::reverse(corners.begin(), corners.end());
}

std::optional<BoardCorners> findChessboard(const Board& board, const cv::Mat& grey) {
  const cv::Size size(board.columns, board.rows);
  // Large photographs are searched at 1600 pixels, where squares are found as well and much faster.
  const double factor = std::max(1.0, std::max(grey.cols, grey.rows) / 1600.0);
  cv::Mat small = grey;
  if (factor > 1) cv::resize(grey, small, {}, 1 / factor, 1 / factor, cv::INTER_AREA);
  std::vector<cv::Point2f> corners;
  if (!cv::findChessboardCorners(small, size, corners, cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE) &&
      !cv::findChessboardCornersSB(small, size, corners, cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_EXHAUSTIVE))
    return std::nullopt;
  for (cv::Point2f& p : corners)
    p = {static_cast<float>((p.x + 0.5) * factor - 0.5), static_cast<float>((p.y + 0.5) * factor - 0.5)};
  // The window must not reach the next corner.
  double spacing = INFINITY;
  for (int row = 0; row < size.height; ++row)
    for (int column = 0; column < size.width; ++column) {
      const cv::Point2f& p = corners[static_cast<std::size_t>(row * size.width + column)];
      if (column > 0) spacing = std::min(spacing, cv::norm(p - (&p)[-1]));
      if (row > 0) spacing = std::min(spacing, cv::norm(p - (&p)[-size.width]));
    }
  const int half = std::clamp(static_cast<int>(std::lround(0.4 * spacing)), 2, factor > 1 ? 25 : 11);
  cv::cornerSubPix(grey, corners, {half, half}, {-1, -1}, {cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 60, 1e-4});
  orderCorners(board, grey, corners);
  BoardCorners found;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (!std::isfinite(corners[i].x) || !std::isfinite(corners[i].y)) return std::nullopt;
    found.ids.push_back(static_cast<int>(i));
    found.pixels.push_back({corners[i].x + 0.5, corners[i].y + 0.5});
  }
  return found;
}

}  // namespace

Point<BoardSpace> Board::corner(int i, double millimetre) const {
  const int column = i % cornerColumns(), row = i / cornerColumns();
  const double x = column - 0.5 * (cornerColumns() - 1), y = 0.5 * (cornerRows() - 1) - row;
  return {x * square * millimetre, y * square * millimetre, 0};
}

bool Board::turnsIntoItself() const {
  return kind == Kind::chessboard && (columns + rows) % 2 == 0;
}

std::string Board::text() const {
  const std::string size = std::to_string(columns) + "x" + std::to_string(rows) + ":" + shortNumber(square) + "mm";
  if (kind == Kind::chessboard) return "chessboard:" + size;
  return "charuco:" + size + ":" + shortNumber(marker) + "mm:" + dictionary;
}

Board parseBoard(const std::string& text) {
  std::vector<std::string> words{""};
  for (const char c : text)
    if (c == ':')
      words.emplace_back();
    else
      words.back() += c;
  Board board;
  if (words[0] == "charuco" || words[0] == "chessboard") {
    board.kind = words[0] == "charuco" ? Board::Kind::charuco : Board::Kind::chessboard;
    words.erase(words.begin());
  }
  const bool charuco = board.kind == Board::Kind::charuco;
  if (words.size() < 2 || words.size() > (charuco ? 4U : 2U)) throw notABoard(text, "has too few or too many parts");
  int used = 0;
  if (std::sscanf(words[0].c_str(), "%dx%d%n", &board.columns, &board.rows, &used) != 2 ||
      used != static_cast<int>(words[0].size()) || board.columns < 3 || board.rows < 3 || board.columns > 100 ||
      board.rows > 100)
    throw notABoard(text, "'" + words[0] + "' is not a number of columns and rows from 3 to 100");
  board.square = parseLength(text, words[1]);
  if (!charuco) return board;
  board.marker = words.size() > 2 ? parseLength(text, words[2]) : 0.75 * board.square;
  if (!(board.marker < board.square)) throw notABoard(text, "the marker is not smaller than the square");
  board.dictionary = words.size() > 3 ? words[3] : "5X5_100";
  std::transform(board.dictionary.begin(), board.dictionary.end(), board.dictionary.begin(), ::toupper);
  if (std::find(std::begin(kDictionaries), std::end(kDictionaries), board.dictionary) == std::end(kDictionaries)) {
    const std::string near = nearestWord(board.dictionary, {std::begin(kDictionaries), std::end(kDictionaries)});
    throw notABoard(text, "'" + words[3] + "' is no dictionary" + (near.empty() ? "" : "; did you mean " + near + "?"));
  }
  const int markers = board.columns * board.rows / 2, codes = dictionaryOf(board)->bytesList.rows;
  if (markers > codes)
    throw notABoard(text, "needs " + std::to_string(markers) + " markers and the dictionary has " +
                              std::to_string(codes) + ": take a larger one");
  return board;
}

Image8 greyPhotograph(const std::filesystem::path& file) {
  const LoadedImage photo = readImage(file);
  const ImageF& in = photo.pixels;
  const int colours = in.channels() - (photo.has_alpha ? 1 : 0);
  ImageF grey(in.width(), in.height(), 1);
  for (int y = 0; y < in.height(); ++y)
    for (int x = 0; x < in.width(); ++x) {
      const float value =
          colours < 3 ? in.at(x, y) : 0.2126F * in.at(x, y, 0) + 0.7152F * in.at(x, y, 1) + 0.0722F * in.at(x, y, 2);
      grey.at(x, y) = std::isfinite(value) ? value : 0;
    }
  double exposure = 1;
  if (photo.is_float && !grey.data().empty()) {
    std::vector<float> values = grey.data();
    const auto high = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
    std::nth_element(values.begin(), high, values.end());
    if (*high > 0) exposure = 1 / *high;
  }
  return displayImage(grey, exposure);
}

std::optional<BoardCorners> findBoard(const Board& board, const Image8& grey, const std::filesystem::path& file) {
  SRF_CHECK(grey.channels() == 1);
  const cv::Mat pixels(grey.height(), grey.width(), CV_8UC1, const_cast<std::uint8_t*>(grey.data().data()));
  if (pixels.cols < 16 || pixels.rows < 16) return std::nullopt;
  try {
    return board.kind == Board::Kind::charuco ? findCharuco(board, pixels, file) : findChessboard(board, pixels);
  } catch (const cv::Exception& e) {
    throw badInput(file.string(), std::string("OpenCV could not look for the board (") + e.err +
                                      "); leave the photograph out with --leave-out");
  }
}

std::vector<PrintedRectangle> printedBoard(const Board& board) {
  std::vector<PrintedRectangle> parts;
  const double s = board.square;
  for (int row = 0; row < board.squareRows(); ++row)
    for (int column = 0; column < board.squareColumns(); ++column)
      if ((row + column) % 2 == 0) parts.push_back({column * s, row * s, s, s, true});
  if (board.kind == Board::Kind::chessboard) return parts;
  const auto dictionary = dictionaryOf(board);
  const int cells = dictionary->markerSize + 2;
  const double inset = 0.5 * (s - board.marker), cell = board.marker / cells;
  const auto squares = markerSquares(board, false);
  for (std::size_t id = 0; id < squares.size(); ++id) {
    cv::Mat picture;
    cv::aruco::drawMarker(dictionary, static_cast<int>(id), cells, picture, 1);
    const double left = squares[id].column * s + inset, top = squares[id].row * s + inset;
    parts.push_back({left, top, board.marker, board.marker, true});
    for (int y = 0; y < cells; ++y)
      for (int x = 0, end = 0; x < cells; x = end) {
        for (end = x; end < cells && (picture.at<std::uint8_t>(y, end) > 0) == (picture.at<std::uint8_t>(y, x) > 0);)
          ++end;
        if (picture.at<std::uint8_t>(y, x) > 0)
          parts.push_back({left + x * cell, top + y * cell, (end - x) * cell, cell, false});
      }
  }
  return parts;
}

void printBoard(const Board& board, const std::filesystem::path& file) {
  if (board.squareRows() % 2 == 0 && board.kind == Board::Kind::charuco)
    throw Error(ErrorKind::usage,
                "has an even number of rows, which OpenCV before and from 4.6 lay out differently: give it an odd one",
                "board '" + board.text() + "'");
  // Margins of a square, so that the outer squares have white around them; below, the text and a ruler.
  const double margin = std::max(board.square, 10.0), foot = 14;
  const double width = board.squareColumns() * board.square + 2 * margin,
               height = board.squareRows() * board.square + 2 * margin + foot;
  const double ruler = std::min(100.0, 10 * std::floor(board.squareColumns() * board.square / 10));
  const std::string text = "srf calibrate --board " + board.text() + "   the line is " + shortNumber(ruler) +
                           " mm: print at 100 %, measure it, glue the board to something flat";
  const double base = height - margin + 2;
  std::string out;
  const auto add = [&](const char* format, auto... values) {
    char line[256];
    std::snprintf(line, sizeof line, format, values...);
    out += line;
  };
  const std::string ending = file.extension().string();
  if (ending == ".svg") {
    add("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%.6gmm\" height=\"%.6gmm\" viewBox=\"0 0 %.6g %.6g\" "
        "shape-rendering=\"crispEdges\">\n<rect width=\"100%%\" height=\"100%%\" fill=\"#fff\"/>\n",
        width, height, width, height);
    for (const PrintedRectangle& r : printedBoard(board))
      add("<rect x=\"%.6g\" y=\"%.6g\" width=\"%.6g\" height=\"%.6g\" fill=\"%s\"/>\n", r.x + margin, r.y + margin,
          r.width, r.height, r.dark ? "#000" : "#fff");
    add("<rect x=\"%.6g\" y=\"%.6g\" width=\"%.6g\" height=\"0.4\" fill=\"#000\"/>\n", margin, base, ruler);
    add("<text x=\"%.6g\" y=\"%.6g\" font-family=\"sans-serif\" font-size=\"3\">", margin, base + 5);
    out += text + "</text>\n</svg>\n";
    return writeTextFile(file, out);
  }
  if (ending != ".pdf") throw Error(ErrorKind::usage, "ends in '" + ending + "', expected .svg or .pdf", file.string());
  // The least PDF there is: one page, one stream of rectangles, y upwards, 72 points an inch.
  add("%.9g 0 0 %.9g 0 0 cm\n", 72 / 25.4, 72 / 25.4);
  for (const PrintedRectangle& r : printedBoard(board))
    add("%d g %.6g %.6g %.6g %.6g re f\n", r.dark ? 0 : 1, r.x + margin, height - margin - r.y - r.height, r.width,
        r.height);
  add("0 g %.6g %.6g %.6g 0.4 re f\nBT /F 3 Tf %.6g %.6g Td (", margin, height - base, ruler, margin,
      height - base - 5);
  out += text + ") Tj ET\n";
  char page[160];
  std::snprintf(
      page, sizeof page,
      "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 %.6g %.6g] /Contents 4 0 R /Resources << /Font << /F 5 0 R "
      ">> >> >>",
      width * 72 / 25.4, height * 72 / 25.4);
  const std::string objects[] = {"<< /Type /Catalog /Pages 2 0 R >>", "<< /Type /Pages /Kids [3 0 R] /Count 1 >>", page,
                                 "<< /Length " + std::to_string(out.size()) + " >>\nstream\n" + out + "endstream",
                                 "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"};
  std::string pdf = "%PDF-1.4\n", table;
  int number = 0;
  for (const std::string& object : objects) {
    char entry[32];
    std::snprintf(entry, sizeof entry, "%010zu 00000 n \n", pdf.size());
    table += entry;
    pdf += std::to_string(++number) + " 0 obj\n" + object + "\nendobj\n";
  }
  const std::string start = std::to_string(pdf.size());
  pdf += "xref\n0 6\n0000000000 65535 f \n" + table + "trailer\n<< /Size 6 /Root 1 0 R >>\nstartxref\n" + start +
         "\n%%EOF\n";
  writeTextFile(file, pdf);
}

}  // namespace srf
