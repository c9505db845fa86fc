#!/usr/bin/env bash
# The hard cases at full size, in every build: optimised, with the sanitizers, without optimisation, without wide code.
# Writes doc/hard_cases.md and its pictures from what the tests measured. Arguments: the builds to run (presets; all
# without any).
#   tools/nightly.sh                    hours
#   tools/nightly.sh release debug      two builds
#   SRF_NIGHTLY=0 tools/nightly.sh      every build at the size that runs with each change
set -euo pipefail
cd "$(dirname "$0")/.."
builds=("$@")
((${#builds[@]})) || builds=(release scalar debug asan tsan)
export SRF_NIGHTLY=${SRF_NIGHTLY:-1}

tools/install.sh
records=$(mktemp -d)
trap 'rm -rf "$records"' EXIT
failed=0
for build in "${builds[@]}"; do
  cmake --preset "$build" > /dev/null
  cmake --build --preset "$build" -j "$(nproc)"
  if [[ $build == "${builds[0]}" ]]; then
    mkdir -p doc/images/hard_cases
    export SRF_HARD_CASE_PICTURES=$PWD/doc/images/hard_cases
  else
    unset SRF_HARD_CASE_PICTURES
  fi
  # Embree and TBB are not built with the thread sanitizer: what they do inside is not ours to judge.
  TSAN_OPTIONS="suppressions=$PWD/tools/nightly/tsan.txt" SRF_HARD_CASES="$records/$build" \
    ctest --test-dir "build/$build" --output-on-failure --timeout 7200 -j 1 -E '^apps/' || failed=1
done
tools/nightly/page.py "$records" "${builds[@]}" > doc/hard_cases.md.part
mv doc/hard_cases.md.part doc/hard_cases.md
exit "$failed"
