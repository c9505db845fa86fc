#!/usr/bin/env bash
# Real photographs the whole way: two sparse rings become animations, one dense ring is measured against photographs that
# were left out. What came of it is in doc/real_captures.md.
#   tools/real_captures.sh DATA OUTPUT    DATA holds middlebury/dinoSparseRing, templeSparseRing and dinoRing48
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
