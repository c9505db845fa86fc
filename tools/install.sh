#!/usr/bin/env bash
# Installs what building and running need on Debian 12. Does nothing where all of it is there.
set -euo pipefail

packages=(
  # compiler and build; ccache makes a second build short
  g++ cmake ninja-build pkg-config ccache
  # rays and threads
  libembree-dev libtbb-dev
  # pictures; OpenImageIO's CMake files ask for its tools
  libopenexr-dev libopenimageio-dev openimageio-tools
  # silhouettes, lenses, ChArUco boards; point clouds and meshes
  libopencv-dev libopencv-contrib-dev libeigen3-dev libcgal-dev
  # JSON, command lines, compression, checksums
  nlohmann-json3-dev libcli11-dev libzstd-dev libxxhash-dev
  # vector code for the instruction set at hand
  libhwy-dev
  # tests and benchmarks
  libgtest-dev librapidcheck-dev libbenchmark-dev
  # XML and MATLAB files of captures in other formats
  libpugixml-dev libmatio-dev
  # videos; structure from motion, both run as programs
  ffmpeg colmap
)

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true)
  [[ $status == *"ok installed" ]] || missing+=("$package")
done
if ((${#missing[@]} == 0)); then exit 0; fi

as_root=()
if ((EUID != 0)); then
  if ! command -v sudo >/dev/null; then
    echo "install.sh: missing: ${missing[*]}" >&2
    echo "install.sh: install them as root, or install sudo and run this again" >&2
    exit 1
  fi
  as_root=(sudo)
fi
echo "installing: ${missing[*]}"
"${as_root[@]}" apt-get update -q
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}"
