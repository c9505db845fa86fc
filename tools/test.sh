#!/usr/bin/env bash
# Installs, builds and runs every test; run again, it does only what is left to do. Arguments go to ctest (e.g. -R hull).
set -euo pipefail
cd "$(dirname "$0")/.."

tools/install.sh
cmake --preset release
cmake --build --preset release -j "$(nproc)"
ctest --test-dir build/release --output-on-failure -j "$(nproc)" "$@"
