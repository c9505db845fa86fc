#!/usr/bin/env bash
# Real photographs the whole way: two sparse rings become animations, one dense ring is measured against photographs that
# were left out. What came of it is in doc/real_captures.md.
#   tools/real_captures.sh DATA OUTPUT    DATA holds middlebury/dinoSparseRing, templeSparseRing and dinoRing48; and ulr-kettle
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,4s/^# *//p' "$0" >&2
  exit 2
fi
data=$1 output=$2 root=$(cd "$(dirname "$0")/.." && pwd)
build=${SRF_BUILD:-$root/build/release}
for ring in dinoSparseRing templeSparseRing dinoRing48; do
  if [[ ! -d $data/middlebury/$ring ]]; then
    echo "$data/middlebury/$ring is missing: name the folder that holds middlebury/" >&2
    exit 3
  fi
done
mkdir -p "$output"

for name in dino temple; do
  "$build/apps/srf" pipeline "$data/middlebury/${name}SparseRing" --scene "$root/doc/scenes/${name}_sparse_ring.json" \
    -o "$output/$name" --stats "$output/$name.json"
done
"$build/bench/holdout_benchmark" "$data/middlebury/dinoRing48" --every 4 --tolerance 2 | tee "$output/dino_left_out.md"

# 28 hand-held photographs of a kettle before cloth: its author's COLMAP model, masks by GrabCut in a box.
if [[ -d $data/ulr-kettle ]]; then
  mkdir -p "$output/kettle_model"
  cp "$data/ulr-kettle/cameras.txt" "$data/ulr-kettle/images.txt" "$output/kettle_model"
  : > "$output/kettle_model/points3D.txt"  # the set has none
  "$build/apps/srf" calibrate "$data/ulr-kettle/images" -o "$output/kettle" --colmap "$output/kettle_model"
  "$build/bench/holdout_benchmark" "$output/kettle" --every 4 --grabcut --bounds=-2.3,-3.5,8.5,3.5,2.3,14.3 \
    --sheet "$output/kettle_left_out.png" | tee "$output/kettle_left_out.md"
fi
