#!/usr/bin/env bash
# From nothing to a moving, bending, relit object in demo/: installs, builds, makes a synthetic capture and takes it the whole
# way. Run again, it does only what is left to do.
set -euo pipefail
cd "$(dirname "$0")/.."

tools/install.sh
cmake --preset release
cmake --build --preset release -j "$(nproc)" --target apps/all

srf=build/release/apps/srf
capture=demo/capture
if [[ ! -e $capture/transforms.json ]]; then
  echo "== photographing a ring of rough plastic, 48 views x 64 lights"
  "$srf" synth -o "$capture" --object torus --material plastic --views 48 --lights 64 --size 160
fi
echo "== photographs to animation"
"$srf" pipeline "$capture" --scene tools/demo/scene.json -o demo > /dev/null

echo
echo "demo/report.html        how it went, and what to look at"
echo "demo/animation.mp4      the video"
echo "demo/contact_sheet.png  its frames at a glance"
echo "demo/frames/            the frames as OpenEXR"
