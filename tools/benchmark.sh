#!/usr/bin/env bash
# Writes doc/performance.md: times of the hull and of every stage of a frame, each beside this machine's limit measured in the
# same run. Run it on a machine that does nothing else. The capture is kept in demo/benchmark.
set -euo pipefail
cd "$(dirname "$0")/.."

cmake --preset release
cmake --build --preset release -j "$(nproc)"
srf=build/release/apps/srf
work=demo/benchmark
mkdir -p "$work"
if [[ ! -e $work/bumpy.srf/manifest.json ]]; then
  [[ -e $work/bumpy/transforms.json ]] ||
    "$srf" synth -o "$work/bumpy" --object bumpy --material plastic --views 36 --lights 100 --size 256 --supersampling 2
  "$srf" acquire "$work/bumpy" -o "$work/bumpy.srf" --hull-resolution 90
  "$srf" model "$work/bumpy.srf"
fi

{
  cat tools/benchmark/introduction.md
  echo
  echo "## Visual hull"
  echo
  echo "| what | ms, median (least .. most) |"
  echo "|---|---|"
  build/release/bench/hull_benchmark
  echo
  echo "## A frame that twists, environment of 256 lights (the first mark)"
  echo
  build/release/bench/stage_benchmark tools/benchmark/twist.json --srf "$work/bumpy.srf"
  echo
  echo "## The same at rest: one orientation for every point"
  echo
  build/release/bench/stage_benchmark tools/benchmark/twist.json --srf "$work/bumpy.srf" --set /deformation=[]
  echo
  echo "## The same with every light weight exact (no sharing)"
  echo
  build/release/bench/stage_benchmark tools/benchmark/twist.json --srf "$work/bumpy.srf" --set /accuracy/light_sharing=0 --repeats 3
  echo
  echo "## Deforming and refitting a million triangles"
  echo
  build/release/bench/deform_benchmark
} > "$work/performance.md"
mv "$work/performance.md" doc/performance.md
