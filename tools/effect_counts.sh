#!/usr/bin/env bash
# Counts instructions (callgrind) of one small frame without and with each effect: an effect's function runs in no scene
# without it, and a key that turns it on leaves the counts of the rest where they were, within 0.1 %. Takes a minute.
# Argument: the folder of a release build (build/release). Ends with 77 where there is no valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind > /dev/null || { echo "skipped: no valgrind here; apt-get install valgrind"; exit 77; }
srf=$(realpath "${1:-build/release}")/apps/srf
studio=$PWD/tools/demo/studio.exr
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

"$srf" synth -o capture --object sphere --material lambert --views 8 --lights 8 --size 32 > synth.log 2>&1
"$srf" acquire capture -o x.srf > acquire.log 2>&1
"$srf" model x.srf > model.log 2>&1
cat > scene.json << 'JSON'
{"srf": "x.srf", "frames": "0",
 "camera": {"w": 32, "h": 24, "vfov": 40, "look_at": {"eye": [0, -4, 1], "target": [0, 0, 0], "up": [0, 0, 1]}},
 "deformation": [{"type": "twist", "axis": [0, 0, 1], "degrees_per_unit": 20}],
 "interpolation": "plain",
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
expect() {  # what is said, condition of awk
  if awk "BEGIN { exit !($2) }"; then say ok "$1"; else say FAILED "$1"; failed=1; fi
}
same() {  # run, how many times as much, functions
  local without with
  for f in "${@:3}"; do
    without=$(of bare "$f") with=$(of "$1" "$f")
    expect "  $f: $without, $with" "$without > 0 && ($with - $2 * $without) ^ 2 <= (0.001 * $2 * $without) ^ 2"
  done
}
check() {  # run, function that runs with the arguments and not without, arguments in one word, functions that must not change
  local words
  read -ra words <<< "$3"
  count "$1" "${words[@]}"
  local without with
  without=$(of bare "$2") with=$(of "$1" "$2")
  expect "$3: $2 takes $with instructions, without $without" "$with > 0 && $without == 0"
  same "$1" 1 "${@:4}"
}
count bare
hits=("lookUp(" DeferredShading::execute FrameLighting::gather)
views=(ViewSelection::select ViewSelection::choose)
rays=(DeformedModel::blendTriangles "detail::RayBackend::intersect(")
model=("DeformedModel::carry(")
# A ground is met by rays beside the object too, so tracing is not of what must stay.
check ground GroundShading::shade '--set /effects={"ground":{"height":-1.5}}' "${hits[@]}" "${views[@]}" "${model[@]}"
# The captured lights that stand for one are weighed by whether they reach the place: the lights are of what changes.
check both CastShadows::gather '--set /effects={"shadows":"both"}' "${hits[@]:0:2}" "${views[@]}" "${rays[@]}" "${model[@]}"
# Dividing the rest pose's shadows out takes the model at rest beside the deformed one.
check deformed CastShadows::gather '--set /effects={"shadows":"deformed"}' "${hits[@]:0:2}" "${views[@]}" "${rays[@]}"
# Other rays meet other places.
check lens 'throughLens(' '--set /effects={"depth_of_field":{"aperture":0.05,"focus":4}}' "${model[@]}"
# Layers tell of the views, which are then kept and not turned into operations at once.
check layers Layers::set '--aovs confidence' "${hits[@]}" "${rays[@]}" "${model[@]}"
check support CaptureSupport::at '--aovs extrapolation' "${hits[@]}" "${rays[@]}" "${model[@]}"
check environment sampleEnvironment "--set /lights/1={\"type\":\"environment\",\"map\":\"$studio\",\"samples\":16}" \
  'lookUp(' "${views[@]}" "${rays[@]}" "${model[@]}"
check point N_AVX2::towards '--set /lights/1={"type":"point","position":[2,-2,2],"intensity":[1,1,1]}' \
  'lookUp(' "${views[@]}" "${rays[@]}" "${model[@]}"
# These have no function of their own. What moves is carried once a moment, which this scene's deformation does not.
count blur --set '/effects={"motion_blur":{"shutter":0.5,"samples":4}}'
say "" "motion blur of 4 moments"
same blur 4 'lookUp(' DeformedModel::blendTriangles
same blur 1 "${model[@]}"
count matte --set '/effects={"matte":true}'
say "" "matte"
same matte 1 'lookUp(' FrameLighting::gather "${rays[@]}" "${model[@]}"
check guided GuidedLighting:: '--set /interpolation="guided"' "${rays[@]}" "${model[@]}"
exit $failed
