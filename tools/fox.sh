#!/usr/bin/env bash
# A fox photographed under 40 lights, one at a time, walks by the skeleton that its author gave it, under other lights.
#   tools/fox.sh DATA OUTPUT    DATA holds animated/Fox.glb (Khronos sample assets); OUTPUT/animation/animation.mp4 is made
# The photographs are rendered by Blender's Cycles: PYTHON names a Python with its module (pip install bpy==5.0.1 'numpy<2').
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,4s/^# *//p' "$0" >&2
  exit 2
fi
data=$1 output=$2 root=$(cd "$(dirname "$0")/.." && pwd)
build=${SRF_BUILD:-$root/build/release}
mkdir -p "$output"
if [[ ! -f $output/capture/transforms.json ]]; then
  "${PYTHON:-python3}" "$root/tools/fox/capture.py" "$data/animated/Fox.glb" "$output/capture" --views 48 --lights 40 --size 208
fi
cp "$root/tools/fox/scene.json" "$root/tools/demo/studio.exr" "$data/animated/Fox.glb" "$output/"
# The low-resolution mesh of the file is a proxy for the fine surface.
"$build/apps/srf" pipeline "$output/capture" --scene "$output/scene.json" --shape "$output/capture/surface.ply" \
  -o "$output/animation"
