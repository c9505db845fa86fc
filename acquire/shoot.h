// A shoot: a folder of photographs whose paths say which view, light and exposure each of them is. One pattern
// describes it to every part of `srf calibrate`.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace srf {

/// One photograph; fields that the pattern does not have are empty.
struct ShootPhoto {
  std::filesystem::path file;
  std::string view, light, exposure, camera;
};

/// The photographs of `folder` whose path below it fits `pattern`, in natural order of view, light and exposure
/// ("l2" before "l10"), camera before all. The pattern is a path with '/' between folders; {camera}, {view}, {light}
/// and {exposure} each stand for one or more characters other than '/', * for any number of them. A pattern that ends
/// in
/// ".*" takes every image format. Masks (mask.png, NAME.mask.tga, NAME_mask.png, NAME-mask.png) are no photographs.
/// Throws usage for a pattern that is none, bad_input where nothing fits (naming a file that does not) or where two
/// files are the same view, light and exposure.
std::vector<ShootPhoto> findPhotos(const std::filesystem::path& folder, const std::string& pattern);

/// "2" before "10"; case and everything else by character.
bool naturallyBefore(const std::string& a, const std::string& b);

/// A table of comma-separated values: one row a line, '#' starts a comment, blanks around cells are dropped. Rows are
/// kept by their first cell, without a header line (a first row none of whose other cells is a number). Decimal
/// fractions like 1/60 are numbers. Throws bad_input that names the line where a row has another number of values than
/// `columns`, a value that is no number, or a first cell that was there before.
std::map<std::string, std::vector<double>> readNamedTable(const std::filesystem::path& file, std::size_t columns);

}  // namespace srf
