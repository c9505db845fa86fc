// Arrays of a numpy .npz file (deflated zip of .npy), for truth that an independent program wrote.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace srf::test {

/// float32 and bool arrays by name, in C order, as floats.
std::map<std::string, std::vector<float>> readNpz(const std::filesystem::path& file);

}  // namespace srf::test
