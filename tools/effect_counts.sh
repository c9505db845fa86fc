#!/usr/bin/env bash
# Counts instructions (callgrind) of one small frame without and with each effect: no function of an effect runs in a
# scene without it, and a key that turns one on leaves the counts of the rest where they were, within 0.1 %.
# Needs valgrind and a release build; takes some minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind > /dev/null || { echo "no valgrind here: apt-get install valgrind"; exit 1; }
srf=$PWD/build/release/apps/srf
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

"$srf" synth -o capture --object sphere --material lambert --views 8 --lights 8 --size 32 > synth.log 2>&1
"$srf" acquire capture -o x.srf > acquire.log 2>&1
"$srf" model x.srf --fit off > model.log 2>&1
cat > scene.json << 'JSON'
{"srf": "x.srf", "frames": "0",
 "camera": {"w": 32, "h": 24, "vfov": 40, "look_at": {"eye": [0, -4, 1], "target": [0, 0, 0], "up": [0, 0, 1]}},
 "deformation": [{"type": "twist", "axis": [0, 0, 1], "degrees_per_unit": 20}],
 "lights": [{"type": "directional", "direction": [0, -1, 1], "irradiance": [1, 1, 1]}]}
JSON

# Instructions by function, its own alone (what it calls may allocate, which costs what the heap happens to look like):
# one line "count name".
count() {  # name of the run, further arguments of srf render
  local name=$1
  shift
  valgrind --tool=callgrind --callgrind-out-file="$name.out" "$srf-render" scene.json -o "$name.####.exr" --threads 1 \
    --progress none "$@" > "$name.log" 2>&1 || { cat "$name.log"; exit 1; }
  callgrind_annotate --threshold=100 "$name.out" 2> /dev/null |
    sed -nE 's/^ *([0-9,]+) \([^)]*\) +[^:]*:(.*)$/\1 \2/p' | tr -d , > "$name.txt"
}
of() {  # run, function: its instructions, 0 where it did not run
  awk -v f="srf::$2" 'index($0, f) { print $1; found = 1; exit } END { if (!found) print 0 }' "$1.txt"
}

failed=0
say() { printf '%-8s %s\n' "$@"; }
count bare
for f in GroundShading::shade CastShadows::gather GuidedLighting:: CaptureSupport::at ThinLens:: Layers::set; do
  n=$(of bare "$f")
  if [[ $n == 0 ]]; then say ok "$f does not run"; else say FAILED "$f runs in a scene without it: $n"; failed=1; fi
done

check() {  # run, function that must run now, key as set, functions that must not change
  count "$1" --set "$3"
  local n
  n=$(of "$1" "$2")
  if [[ $n == 0 ]]; then say FAILED "$3: $2 does not run"; failed=1; else say ok "$3: $2 takes $n instructions"; fi
  for f in "${@:4}"; do
    local before after
    before=$(of bare "$f") after=$(of "$1" "$f")
    if awk -v a="$before" -v b="$after" 'BEGIN { exit !(a > 0 && (b - a) ^ 2 <= (0.001 * a) ^ 2) }'; then
      say ok "  $f: $before, $after"
    else
      say FAILED "  $f: $before, then $after"
      failed=1
    fi
  done
}
rest=("lookUp(" ViewSelection::select ViewSelection::lookAt DeferredShading::execute "DeformedModel::carry(")
# A ground is met by rays beside the object too, so tracing is not of what must stay.
check ground GroundShading::shade '/effects={"ground": {"height": -1.5}}' "${rest[@]}" FrameLighting::gather
check both CastShadows::gather '/effects={"shadows": "both"}' "${rest[@]}" DeformedModel::intersectTriangles
# Dividing the rest pose's shadows out takes the model at rest beside the deformed one.
check deformed CastShadows::gather '/effects={"shadows": "deformed"}' "${rest[@]:0:4}" DeformedModel::intersectTriangles
exit $failed
