#include "apps/html.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>

#include "base/numeric.h"
#include "base/text.h"

namespace srf::html {

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else if (c == '"')
      out += "&quot;";
    else
      out += c;
  }
  return out;
}

std::string base64(const std::vector<std::byte>& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k)
      group = group << 8 | (k < left ? std::to_integer<std::uint32_t>(bytes[i + k]) : 0);
    for (std::size_t k = 0; k < 4; ++k) out += k <= left ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

const char* const kStyle = R"(
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:960px;margin:2em auto;padding:0 1em}
h1{font-size:1.6em;margin-bottom:0}h2{font-size:1.15em;margin:2em 0 .3em;border-bottom:1px solid #ddd}
p{margin:.4em 0}.note{color:#666}table{border-collapse:collapse}td,th{padding:.15em 1em .15em 0;text-align:left;vertical-align:top}
td.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%;background:#000}svg{max-width:100%;height:auto}
code{background:#f4f4f4;padding:0 .3em}.bar{background:#4a7ebb;height:.8em;min-width:1px}.warn{color:#a33}
svg text{font:11px system-ui,sans-serif;fill:#555})";

constexpr double kRadius = 190;  // of a half's circle, pixels

void HemisphereMap::add(const Vec3& direction, bool light) {
  const int half = direction.z >= 0 ? 0 : 1;
  const double in_plane = std::hypot(direction.x, direction.y);
  const double r = kRadius * std::sqrt(std::max(0.0, 1 - std::fabs(direction.z)));
  const double x = in_plane > 0 ? r * direction.x / in_plane : 0, y = in_plane > 0 ? -r * direction.y / in_plane : 0;
  if (light && !taken_[half].emplace(std::lround(x), std::lround(y)).second) return;
  marks_[half] += light ? format("<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3\" fill=\"#e0a010\"/>\n", x, y)
                        : format(
                              "<rect x=\"%.1f\" y=\"%.1f\" width=\"6\" height=\"6\" fill=\"none\" stroke=\"#2a5d9f\" "
                              "stroke-width=\"1.5\"/>\n",
                              x - 3, y - 3);
}

std::string HemisphereMap::svg() const {
  std::string out = "<svg viewBox=\"0 0 900 440\" width=\"900\">\n";
  for (int half = 0; half < 2; ++half) {
    out += format(
        "<g transform=\"translate(%d,215)\"><circle r=\"%g\" fill=\"#fafafa\" stroke=\"#bbb\"/>"
        "<path d=\"M-%g 0H%gM0 -%gV%g\" stroke=\"#e4e4e4\"/>\n",
        half ? 670 : 230, kRadius, kRadius, kRadius, kRadius, kRadius);
    for (const int degrees : {30, 60})
      out += format("<circle r=\"%.1f\" fill=\"none\" stroke=\"#e4e4e4\"/>\n",
                    kRadius * std::sqrt(1 - std::cos(radians(degrees))));
    out += marks_[half] + format(
                              "<text x=\"%g\" y=\"4\">+x</text><text y=\"-%g\" text-anchor=\"middle\">+y</text>"
                              "<text y=\"%g\" text-anchor=\"middle\">%s</text></g>\n",
                              kRadius + 4, kRadius + 4, kRadius + 18,
                              half ? "below: -z at the centre, seen through from above" : "above: +z at the centre");
  }
  return out + "</svg>\n";
}

}  // namespace srf::html
