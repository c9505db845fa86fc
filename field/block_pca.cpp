// Principal components of a block over its lights. The one file of field/ that includes Eigen.
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/half.h"
#include "field/reflectance_block.h"

namespace srf {
namespace {

constexpr int kTexels = kTile * kTile;
constexpr int kRows = kTexels * 3;  // a texel's channel each
constexpr int kMostRank = 255;
// Of the block's mean: below it a sensor's own noise outweighs that of photons.
constexpr double kDarkShare = 0.05;
constexpr double kLargestStep = 30000;  // of a coefficient, in steps

struct StoredHeader {
  std::uint8_t rank, reserved[3];
};
/// Of one component in stores before version 3, before its basis vector and its coefficients.
struct ShuffledComponent {
  float scale;                ///< of the basis vector, whose largest entry is 1 or -1
  std::uint32_t differences;  ///< 1: coefficients as differences to the texel above (first row: to the left)
};

int rankPad(int rank) {
  return (rank + kRankGroup - 1) / kRankGroup * kRankGroup;
}

// Small numbers of either sign were kept as small numbers.
std::int16_t unfolded(std::uint16_t value) {
  return static_cast<std::int16_t>((value >> 1) ^ -(value & 1));
}

/// Coefficients are kept as a block of so many lights.
StoreGeometry coefficientGeometry(int rank) {
  return {kTile, kTile, 0, 0, 1, 1, rank};
}
static_assert(kRankGroup == kLightGroup);

std::size_t basisBytes(const StoreGeometry& g, int rank) {
  return sizeof(StoredHeader) + rank * (sizeof(float) + 2 * static_cast<std::size_t>(g.light_count));
}

/// False where a block of this geometry has no such rank.
bool begin(const StoreGeometry& g, int rank, ReflectanceBlock& block) {
  block.rank = rank;
  block.pad = rankPad(rank);
  if (rank < 1 || block.pad > g.lightPad()) return false;
  block.halves.assign(static_cast<std::size_t>(kRows) * block.pad, 0);
  block.basis.assign(static_cast<std::size_t>(g.light_count) * block.pad, 0.f);
  return true;
}
/// Sets vector k of the basis from the halves at `from`; false where a number is not finite.
bool setVector(const StoreGeometry& g, int k, float scale, const std::byte* from, ReflectanceBlock& block) {
  if (!std::isfinite(scale)) return false;
  std::vector<std::uint16_t> halves(g.lightPad(), 0);
  std::vector<float> vector(halves.size());
  std::memcpy(halves.data(), from, 2 * static_cast<std::size_t>(g.light_count));
  floatsFromHalves(halves.data(), vector.data(), static_cast<int>(vector.size()));
  for (int j = 0; j < g.light_count; ++j) {
    const float basis = vector[j] * scale;
    if (!std::isfinite(basis)) return false;
    block.basis[static_cast<std::size_t>(j) * block.pad + k] = basis;
  }
  return true;
}
void findLit(const StoreGeometry& g, ReflectanceBlock& block) {
  block.lit.clear();
  for (int j = 0; j < g.light_count; ++j) {
    const auto row = block.basis.begin() + static_cast<std::ptrdiff_t>(j) * block.pad;
    if (std::any_of(row, row + block.rank, [](float value) { return value != 0; })) block.lit.push_back(j);
  }
}

/// Share of the median singular value above which one is more signal than noise, for a matrix whose shorter side is
/// beta times its longer one (Gavish and Donoho 2014, Eq. 5; within 0.02 of their exact values).
double hardThreshold(double beta) {
  return ((0.56 * beta - 0.95) * beta + 1.82) * beta + 1.43;
}

}  // namespace

std::optional<CompressedBlock> compressBlock(const StoreGeometry& g, std::span<const std::uint16_t> block,
                                             double error) {
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const int lights = g.light_count, pad = g.lightPad();
  // Rows without any light (texels without coverage) say nothing and are left out.
  std::vector<int> rows;
  for (int row = 0; row < kRows; ++row) {
    const auto values = block.subspan(static_cast<std::size_t>(row) * pad, pad);
    if (std::any_of(values.begin(), values.end(), [](std::uint16_t v) { return v != 0; })) rows.push_back(row);
  }
  if (rows.empty()) return std::nullopt;
  const int n = static_cast<int>(rows.size());
  Matrix x(n, lights);
  std::vector<float> values(pad);
  for (int i = 0; i < n; ++i) {
    floatsFromHalves(block.data() + static_cast<std::size_t>(rows[i]) * pad, values.data(), pad);
    for (int j = 0; j < lights; ++j) x(i, j) = values[j];
  }
  Eigen::VectorXd deviation = x.colwise().mean().transpose();  // of shot noise, up to a factor
  deviation = (deviation.array() + kDarkShare * deviation.mean()).sqrt();
  x.array().rowwise() /= deviation.transpose().array();

  // The smaller of the two Gram matrices has the squares of all singular values.
  const bool by_lights = lights <= n;
  const int side = std::min(n, lights);
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(side, side);
  if (by_lights)
    gram.selfadjointView<Eigen::Lower>().rankUpdate(x.transpose());
  else
    gram.selfadjointView<Eigen::Lower>().rankUpdate(x);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(gram);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const auto energy = [&](int k) { return std::max(0.0, solver.eigenvalues()[side - 1 - k]); };  // falling
  double all = 0;
  for (int k = 0; k < side; ++k) all += energy(k);
  if (!(all > 0)) return std::nullopt;
  const double threshold =
      std::pow(hardThreshold(static_cast<double>(side) / std::max(n, lights)), 2) * energy(side / 2);
  const int most = std::min({side, kMostRank, static_cast<int>(g.blockHalves() / 2 / kRows)});
  double left = all;
  int rank = 0;
  while (rank < most && (rank == 0 || (left > error * error * all && energy(rank) > threshold))) left -= energy(rank++);
  if (2 * (basisBytes(g, rank) + 2 * static_cast<std::size_t>(rank) * kRows) > g.blockBytes()) return std::nullopt;

  Eigen::MatrixXd components(lights, rank);  // orthonormal columns
  for (int k = 0; k < rank; ++k) {
    const auto vector = solver.eigenvectors().col(side - 1 - k);
    if (by_lights)
      components.col(k) = vector;
    else
      components.col(k) = (x.transpose() * vector) / std::sqrt(energy(k));
    // Which way a component points is the solver's whim.
    if (components.col(k).sum() < 0) components.col(k) = -components.col(k);
  }
  const Matrix coefficients = x * components;
  const double residual = std::sqrt(std::max(0.0, left) / (static_cast<double>(n) * lights));
  const double step = std::max(residual, coefficients.cwiseAbs().maxCoeff() / kLargestStep);

  CompressedBlock result;
  std::vector<std::byte>& stored = result.stored;
  const auto put = [&](const auto& value) {
    const auto* const bytes = reinterpret_cast<const std::byte*>(&value);
    stored.insert(stored.end(), bytes, bytes + sizeof value);
  };
  put(StoredHeader{static_cast<std::uint8_t>(rank), {}});
  std::vector<std::uint16_t> whole(static_cast<std::size_t>(kRows) * rankPad(rank), 0);
  for (int k = 0; k < rank; ++k) {
    const Eigen::VectorXd vector = components.col(k).cwiseProduct(deviation) * step;
    const double scale = std::max(vector.cwiseAbs().maxCoeff(), 1e-30);
    put(static_cast<float>(scale));
    for (int j = 0; j < lights; ++j) put(halfFromFloat(static_cast<float>(vector[j] / scale)));
    for (int i = 0; i < n; ++i)
      whole[static_cast<std::size_t>(rows[i]) * rankPad(rank) + k] =
          static_cast<std::uint16_t>(static_cast<std::int16_t>(std::lround(coefficients(i, k) / step)));
  }
  std::vector<std::byte> packed;
  packBlock(coefficientGeometry(rank), whole.data(), packed);
  stored.insert(stored.end(), packed.begin(), packed.end());
  unpackCompressed(g, stored, result.block);
  return result;
}

bool unpackCompressed(const StoreGeometry& g, std::span<const std::byte> stored, ReflectanceBlock& block) {
  StoredHeader header;
  if (stored.size() < sizeof header) return false;
  std::memcpy(&header, stored.data(), sizeof header);
  if (!begin(g, header.rank, block) || stored.size() < basisBytes(g, block.rank)) return false;
  const std::byte* at = stored.data() + sizeof header;
  for (int k = 0; k < block.rank; ++k) {
    float scale = 0;
    std::memcpy(&scale, at, sizeof scale);
    if (!setVector(g, k, scale, at + sizeof scale, block)) return false;
    at += sizeof scale + 2 * static_cast<std::size_t>(g.light_count);
  }
  if (!unpackBlock(coefficientGeometry(block.rank), stored.subspan(basisBytes(g, block.rank)), block.halves.data()))
    return false;
  for (std::size_t i = 0; i < block.halves.size(); i += kRankGroup) {
    float values[kRankGroup];
    for (int k = 0; k < kRankGroup; ++k) values[k] = static_cast<std::int16_t>(block.halves[i + k]);
    halvesFromFloats(values, &block.halves[i], kRankGroup);  // exact up to 2048 steps
  }
  findLit(g, block);
  return true;
}

bool unpackShuffledCompressed(const StoreGeometry& g, std::span<const std::byte> stored, ReflectanceBlock& block) {
  StoredHeader header;
  if (stored.size() < sizeof header) return false;
  std::memcpy(&header, stored.data(), sizeof header);
  const int rank = header.rank;
  const std::size_t vector_bytes = sizeof(ShuffledComponent) + 2 * static_cast<std::size_t>(g.light_count);
  if (stored.size() != sizeof header + rank * (vector_bytes + 2 * kRows) || !begin(g, rank, block)) return false;
  const std::byte* at = stored.data() + sizeof header;
  const std::byte* low = at + rank * vector_bytes;
  const std::byte* high = low + static_cast<std::size_t>(rank) * kRows;
  std::int16_t whole[kRows];
  float values[kRows];
  std::uint16_t coefficients[kRows];
  constexpr int kWide = 3 * kTile;  // a row of texels
  for (int k = 0; k < rank; ++k, at += vector_bytes, low += kRows, high += kRows) {
    ShuffledComponent head;
    std::memcpy(&head, at, sizeof head);
    if (!setVector(g, k, head.scale, at + sizeof head, block)) return false;
    for (int row = 0; row < kRows; ++row)
      whole[row] =
          unfolded(static_cast<std::uint16_t>(static_cast<unsigned>(low[row]) | static_cast<unsigned>(high[row]) << 8));
    if (head.differences) {
      for (int row = 3; row < kWide; ++row) whole[row] = static_cast<std::int16_t>(whole[row] + whole[row - 3]);
      for (std::int16_t* to = whole + kWide; to < whole + kRows; to += kWide)
        for (int i = 0; i < kWide; ++i) to[i] = static_cast<std::int16_t>(to[i] + to[i - kWide]);
    }
    for (int row = 0; row < kRows; ++row) values[row] = whole[row];
    halvesFromFloats(values, coefficients, kRows);
    for (int row = 0; row < kRows; ++row)
      block.halves[static_cast<std::size_t>(row) * block.pad + k] = coefficients[row];
  }
  findLit(g, block);
  return true;
}

void expandBlock(const StoreGeometry& g, const ReflectanceBlock& block, std::span<std::uint16_t> out) {
  if (block.basis.empty()) {
    std::copy(block.halves.begin(), block.halves.end(), out.begin());
    return;
  }
  const int light_pad = g.lightPad();
  std::vector<float> coefficients(block.pad), sum(light_pad);
  std::vector<float> vectors(static_cast<std::size_t>(block.rank) * light_pad, 0.f);  // [k][light]
  for (int k = 0; k < block.rank; ++k)
    for (int j = 0; j < g.light_count; ++j)
      vectors[static_cast<std::size_t>(k) * light_pad + j] = block.basis[static_cast<std::size_t>(j) * block.pad + k];
  for (int row = 0; row < kRows; ++row) {
    std::fill(sum.begin(), sum.end(), 0.f);
    floatsFromHalves(&block.halves[static_cast<std::size_t>(row) * block.pad], coefficients.data(), block.pad);
    for (int k = 0; k < block.rank; ++k) {
      const float coefficient = coefficients[k];
      if (coefficient == 0) continue;
      const float* vector = vectors.data() + static_cast<std::size_t>(k) * light_pad;
      for (int j = 0; j < light_pad; ++j) sum[j] += coefficient * vector[j];
    }
    for (float& value : sum) value = std::clamp(value, 0.f, 65504.f);
    halvesFromFloats(sum.data(), out.data() + static_cast<std::size_t>(row) * light_pad, light_pad);
  }
}

}  // namespace srf
