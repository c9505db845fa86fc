#!/usr/bin/env bash
# The hard cases at full size, in every build: optimised, with the sanitizers, without optimisation, without wide code.
# Writes doc/hard_cases.md and its pictures from what the tests measured. Arguments: the builds to run (presets; all
# without any). `release` runs every test, the others those that measured a hard case there.
# SRF_NIGHTLY=0 runs the size that goes with each change.
#   tools/nightly.sh                    hours
#   tools/nightly.sh release debug      two builds
#   SRF_NIGHTLY=0 tools/nightly.sh      every build at the small size
# SRF_HARD_CASE_RECORDS=FOLDER keeps what was measured there, a file a build, and makes the page of all that it holds; so
# builds can run one at a time.
set -euo pipefail
cd "$(dirname "$0")/.."
builds=("$@")
((${#builds[@]})) || builds=(release scalar debug asan tsan)
export SRF_NIGHTLY=${SRF_NIGHTLY:-1}

tools/install.sh
if [[ -n ${SRF_HARD_CASE_RECORDS:-} ]]; then
  records=$SRF_HARD_CASE_RECORDS
  mkdir -p "$records"
else
  records=$(mktemp -d)
  trap 'rm -rf "$records"' EXIT
fi
mkdir -p doc/images/hard_cases
targets=(test_base test_field test_acquire test_visual_hull test_synthetic test_model test_render test_property test_regression)
failed=0
for build in "${builds[@]}"; do
  cmake --preset "$build" -DSRF_TEST_TIMEOUT=14400 > /dev/null
  cmake --build --preset "$build" -j "$(nproc)" --target "${targets[@]}"
  only=()
  # Of release alone, whose pictures these are and which has no sanitizer to please.
  if [[ $build == release ]]; then
    export SRF_HARD_CASE_PICTURES=$PWD/doc/images/hard_cases
  else
    unset SRF_HARD_CASE_PICTURES
    [[ ! -e $records/release ]] || only=(-R "$(tools/nightly/page.py --tests "$records/release")")
  fi
  rm -f "$records/$build"
  # What is freed waits in the address sanitizer's quarantine, 256 MB by default, and would count as memory held.
  # Embree and TBB are not built with the thread sanitizer: what they do inside is not ours to judge.
  ASAN_OPTIONS=quarantine_size_mb=8:thread_local_quarantine_size_kb=64 \
  TSAN_OPTIONS="suppressions=$PWD/tools/nightly/tsan.txt" SRF_HARD_CASES="$records/$build" \
    ctest --test-dir "build/$build" --output-on-failure -j 1 -E '^apps/|_NOT_BUILT' "${only[@]}" || failed=1
done
tools/nightly/page.py "$records" > doc/hard_cases.md.part
mv doc/hard_cases.md.part doc/hard_cases.md
exit "$failed"
