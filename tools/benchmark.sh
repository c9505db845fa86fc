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
  stages=build/release/bench/stage_benchmark
  twist=(tools/benchmark/twist.json --srf "$work/bumpy.srf")
  echo "## A frame that twists: an environment of 256 lights, two point lights (the mark)"
  echo
  "$stages" "${twist[@]}" --exact /accuracy/light_sharing=0
  echo
  echo "## The same at rest: one orientation for every point"
  echo
  "$stages" "${twist[@]}" --set /deformation=[]
  echo
  echo "## The same with every light weight exact (no sharing)"
  echo
  "$stages" "${twist[@]}" --set /accuracy/light_sharing=0 --repeats 3
  echo
  guided=(--set '/interpolation="guided"')
  echo "## The same guided, 8 shadow rays a hit"
  echo
  "$stages" "${twist[@]}" "${guided[@]}" --set /accuracy/shadow_rays=8
  echo
  echo "## What accuracy costs, and what a frame grows with"
  echo
  echo "The last column is the picture's difference from the one at the first row's setting. With \`\"shading\": \"sparse\"\` every second row and column of a block of"
  echo "16 x 16 pixels is shaded, and its borders: a third of the pixels; where the surface runs on smoothly the others take the mean of those about them. Outlines,"
  echo "creases and what lies within a few pixels of them are shaded as ever; what is finer than two pixels, edges of shadows and small highlights, is blurred to that."
  echo "\`\"sparser\"\` is as much coarser again: every fourth row and column, a seventh of the pixels, where the surface is flat over so many pixels."
  echo "With several samples a pixel, or where layers are asked for, everything is shaded, and \`srf explain --pixel\` shades the pixel that it is asked for. With two"
  echo 'views and light weights shared over 8 degrees that makes a preview: `--set /accuracy/views=2 --set /accuracy/light_sharing=8 --set '"'"'/accuracy/shading="sparse"'"'"'`.'
  echo
  echo "| setting | ms a frame, median (least .. most) | frames a second | over the sum of the limits | difference |"
  echo "|---|---|---|---|---|"
  sparse=(--set '/accuracy/shading="sparse"')
  preview=(--set /accuracy/views=2 --set /accuracy/light_sharing=8 "${sparse[@]}")
  exact=(--exact /accuracy/views=4 --exact /accuracy/light_sharing=2 --exact '/accuracy/shading="every"')
  row() { "$stages" "${twist[@]}" --row "$@"; }
  row "as above" --exact /accuracy/light_sharing=0
  row "3 views" --set /accuracy/views=3 "${exact[@]}"
  row "2 views" --set /accuracy/views=2 "${exact[@]}"
  row "1 view" --set /accuracy/views=1 "${exact[@]}"
  row "sharing over 8 degrees" --set /accuracy/light_sharing=8 "${exact[@]}"
  row "sparse shading" "${sparse[@]}" "${exact[@]}"
  row "sparser shading" --set '/accuracy/shading="sparser"' "${exact[@]}"
  row "preview: 2 views, 8 degrees, sparse" "${preview[@]}" "${exact[@]}"
  row "2 views, 8 degrees, sparser" "${preview[@]}" --set '/accuracy/shading="sparser"' "${exact[@]}"
  row "64 environment lights" --set /lights/0/samples=64
  row "1024 environment lights" --set /lights/0/samples=1024
  row "256 x 256 pixels" --set /camera/w=256 --set /camera/h=256
  row "1024 x 1024 pixels" --set /camera/w=1024 --set /camera/h=1024
  row "1024 x 1024, preview" --set /camera/w=1024 --set /camera/h=1024 "${preview[@]}" "${exact[@]}"
  row "one thread" --threads 1
  for rays in 0 4 8 32 256; do
    row "guided, $rays shadow rays a hit" "${guided[@]}" --set /accuracy/shadow_rays=$rays --repeats 5 --exact /accuracy/shadow_rays=256
  done
  row "guided, 8 shadow rays a hit, sparse" "${guided[@]}" --set /accuracy/shadow_rays=8 "${sparse[@]}" --repeats 5 "${exact[@]}"
  sun=(--set '/lights=[{"type":"directional","direction":[-0.3,-0.5,0.8],"irradiance":[3,3,3]}]')
  row "one directional light" "${sun[@]}" --repeats 5
  row "one directional light, guided" "${sun[@]}" "${guided[@]}" --repeats 5
  echo
  echo "## Deforming and refitting a million triangles"
  echo
  build/release/bench/deform_benchmark
  if [[ ! -e $work/many/transforms.json ]]; then
    "$srf" synth -o "$work/many" --object bumpy --material plastic --views 12 --lights 16 --size 1024 --supersampling 1 > /dev/null
  fi
  echo
  echo "## Checking a capture"
  echo
  echo "\`srf check\` reads every photograph once. Beside it a bare loop over as many threads that decodes the same half-float EXR files and looks at none; the rest"
  echo "of the check (masks, hull, shading against the light table) grows with the views, not with the photographs. Milliseconds as median (least .. most)."
  echo
  echo "| capture | bare decoding | whole check | of it the photographs | check over decoding |"
  echo "|---|---|---|---|---|"
  build/release/bench/check_benchmark "$work/many"
  echo
  echo "## A field larger than memory"
  echo
  mkdir -p "$work/fields"
  # Threads' stacks count as data too: small ones.
  (ulimit -s 512 && build/release/bench/out_of_core_benchmark "$work/fields" --plot doc/images/out_of_core.svg)
  echo
  echo "![Seconds a frame against the blocks in the cache, lossless blocks](images/out_of_core.svg)"
  echo
  echo "## Memory by \`--memory\`"
  echo
  echo "Most memory resident, libraries and all, in MB: the field of the mark made, its model, and three frames of it. The plain pictures are the same for every budget."
  echo
  echo "| \`--memory\` | MB allowed | acquire | model | render, plain | render, guided |"
  echo "|---|---|---|---|---|---|"
  for budget in 256M 1G 4G; do
    peaks=()
    measured() {
      "$srf" "$@" --memory "$budget" --stats "$work/stats.json" > /dev/null 2>&1
      peaks+=("$(awk -F'[:,]' '/"peak_memory_bytes"/ { printf "%.0f", $2 / 1e6 }' "$work/stats.json")")
    }
    measured acquire "$work/bumpy" -o "$work/small.srf" --hull-resolution 90
    measured model "$work/small.srf"
    for way in plain guided; do
      measured render tools/benchmark/twist.json --srf "$work/small.srf" --set "/interpolation=\"$way\"" --frames 5-7 \
        -o "$work/$way.$budget.####.exr"
    done
    printf '| %s | %s | %s | %s | %s | %s |\n' "$budget" "$(($(numfmt --from=iec "$budget") / 1000000))" "${peaks[@]}"
    "$srf" compare "$work/plain.$budget.0005.exr" "$work/plain.256M.0005.exr" | grep -q "mean 0 %, 99.9th percentile 0 %"
  done
  echo
  echo "## Kernels, each beside its plain counterpart in double"
  echo
  echo "One thread, everything in the processor's caches (\`bench/kernel_benchmark.cpp\`). An item is a product of a channel and a light, a value of the model, a key or"
  echo "a direction."
  echo
  echo "| kernel | ns a call | million items a second |"
  echo "|---|---|---|"
  build/release/bench/kernel_benchmark --benchmark_format=csv --benchmark_repetitions=5 --benchmark_report_aggregates_only 2> /dev/null |
    awk -F, '/_median/ { gsub(/"|_median/, "", $1); printf "| `%s` | %.0f | %.0f |\n", $1, $4, $NF / 1e6 }'
  echo
  echo "## Other ways to the same"
  echo
  echo "OpenImageIO's ImageCache, which reads a view as tiled OpenEXR with a channel of halves a colour and light, in place of the cache of blocks; and a search of all"
  echo "views, each asked whether it sees the hit, in place of one among those that see a hit's points (which then also places the fetch in the picture). One thread, in turn."
  echo
  mkdir -p "$work/alternatives"
  build/release/bench/alternatives_benchmark "$work/bumpy.srf" "$work/alternatives"
  # Python with mitsuba and numpy, where there is one: see the program's own text.
  if [[ -n ${MITSUBA_PYTHON:-} ]]; then
    echo
    echo "## Against path tracing"
    echo
    echo "The object of the mark on its true shape, frame 5, the environment alone. Ours against the exact picture (\`srf synth --reference\`), the path tracer (Mitsuba 3,"
    echo "llvm_ad_rgb, the true kind of material) against its own converged one. Fewer views lie nearer to the truth, pixel by pixel, for fewer highlights are doubled; in"
    echo "motion they change at once where more would fade."
    echo
    alone=(--set '/lights=[{"type":"environment","map":"../demo/studio.exr","samples":256,"rotation":{"keys":[[0,0],[10,60]]}}]')
    if [[ ! -e $work/true.srf/manifest.json ]]; then
      cp -r "$work/bumpy.srf" "$work/true.srf"
      "$srf" model "$work/true.srf" --shape "$work/bumpy/model.ply" > /dev/null
    fi
    [[ -e $work/truth.0005.exr ]] ||
      "$srf" synth --reference tools/benchmark/twist.json --capture "$work/bumpy" --frames 5 "${alone[@]}" -o "$work/truth.####.exr" > /dev/null
    echo "| ours | ms a frame, median (least .. most) | frames a second | over the sum of the limits | dB within the object |"
    echo "|---|---|---|---|---|"
    errors=()
    for way in plain 'plain, preview: 2 views, 8 degrees, sparse' 'plain, 1 view, 8 degrees, sparse' 'plain, 1 view, 8 degrees, sparser' guided; do
      setting=(--srf "$work/true.srf" "${alone[@]}" --set "/interpolation=\"${way%%,*}\"" --set /accuracy/shadow_rays=8)
      [[ $way != *sparse* ]] || setting+=(--set /accuracy/light_sharing=8 --set "/accuracy/shading=\"${way##* }\"")
      [[ $way =~ ([12])\ view ]] && setting+=(--set "/accuracy/views=${BASH_REMATCH[1]}")
      "$srf" render tools/benchmark/twist.json "${setting[@]}" --frames 5 -o "$work/ours.####.exr" > /dev/null
      errors+=("$("$srf" compare "$work/ours.0005.exr" "$work/truth.0005.exr" | awk '$1 == "inside" { print $3 }')")
      echo "$("$stages" tools/benchmark/twist.json "${setting[@]}" --set '/frames="5"' --row "$way") ${errors[-1]} |"
    done
    echo
    "$srf" model "$work/true.srf" --export "$work/bumpy.ply" > /dev/null
    "$MITSUBA_PYTHON" tools/benchmark/mitsuba_comparison.py tools/benchmark/twist.json "$work/bumpy.ply" --db "${errors[@]:0:4}" 35 40
  fi
} > "$work/performance.md"
mv "$work/performance.md" doc/performance.md
