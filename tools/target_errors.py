#!/usr/bin/env python3
"""Is a target error met? Five scenes of differing kind, each studied, rendered for 1 %, 0.3 % and 0.1 %, and measured.

    tools/target_errors.py -o WORK [--budget 3m] [--scene NAME ...]

Makes synthetic captures and their scenes in WORK, runs `srf study` on each, and renders all frames of the scene (half
of which the study did not look at) with the setting that `srf render --quality --target-error` takes. Prints, as
Markdown, the worst frame's error against the study's all-exact setting, and what that one is: as exact as the budget
allowed. Ends with 1 where a target is missed. Steps whose results are there are not done again.
"""
import argparse
import json
import math
import os
import struct
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SRF = Path(os.environ.get("SRF_BUILD", ROOT / "build/release")) / "apps/srf"
TARGETS = (0.01, 0.003, 0.001)
SIZE = 128
LAST = 16  # frame


def run(*words):
    done = subprocess.run([str(SRF), *map(str, words)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"srf {words[0]}: {done.stderr.strip()[-500:]}")
    return done.stdout


def write_sky(path):
    """A blue sky with a sun of one degree over dark ground, 256 x 128, as Radiance's HDR."""
    def rgbe(colour):
        mantissa, exponent = math.frexp(max(colour))
        return bytes(int(c * math.ldexp(1, 8 - exponent)) for c in colour) + bytes([exponent + 128])
    rows = [b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 128 +X 256\n"]
    for y in range(128):
        up = math.cos(math.pi * (y + 0.5) / 128)
        colour = (0.1, 0.09, 0.08) if up < 0 else (0.5 - 0.3 * up, 0.7 - 0.2 * up, 1.0)
        rows += [rgbe((6000, 5400, 4500)) if y in (40, 41) and x in (60, 61) else rgbe(colour) for x in range(256)]
    path.write_bytes(b"".join(rows))


def write_swaying_meshes(mesh, folder, frames):
    """The binary PLY with its points swaying, the more the higher they stand: a sequence for `deformation`."""
    data = mesh.read_bytes()
    head = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:head].decode().splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    numbers = []
    for line in lines[next(i for i, l in enumerate(lines) if l.startswith("element vertex")) + 1:]:
        if not line.startswith("property"):
            break
        numbers.append({"float": "f", "double": "d", "uchar": "B"}[line.split()[1]])
    vertex = struct.Struct("<" + "".join(numbers))
    for frame in range(frames):
        moved = bytearray(data)
        for i in range(count):
            x, y, z, *rest = vertex.unpack_from(data, head + i * vertex.size)
            x += 0.25 * math.sin(2 * z + 2 * math.pi * frame / frames) * (z + 1)
            vertex.pack_into(moved, head + i * vertex.size, x, y, z, *rest)
        (folder / f"sway.{frame:04d}.ply").write_bytes(moved)


def camera(eye):
    return {"w": SIZE, "h": SIZE, "vfov": 32, "look_at": {"eye": eye, "target": [0, 0, 0], "up": [0, 0, 1]}}


def twist(degrees):
    return {"type": "twist", "axis": [1, 0, 0], "degrees_per_unit": {"keys": [[0, -degrees], [LAST, degrees]]}}


def bend(degrees):
    return {"type": "bend", "axis": [1, 0, 0], "toward": [0, 0, 1], "degrees_per_unit": {"keys": [[0, 0], [LAST, degrees]]}}


def lamp(first, last, intensity):
    return {"type": "point", "intensity": intensity, "position": {"keys": [[0, first], [LAST, last]]}}


STUDIO = {"type": "environment", "map": str(ROOT / "tools/demo/studio.exr"), "samples": 128,
          "rotation": {"keys": [[0, 0], [LAST, 120]]}}

# name: what it is, words for srf synth, words for srf model, the scene.
SCENES = {
    "sky": ("matt bumpy ball, plain, twisted under a sky with a sun",
            "--object bumpy --material lambert", "--kind mesh --fit off",
            {"camera": camera([0.5, -5.5, 1.5]), "deformation": [twist(35)],
             "lights": [{"type": "environment", "map": "../sky.hdr", "samples": 128}], "samples": 4}),
    "lamps": ("glossy ball, guided, bent, two lamps that move, shadows and a ground",
              "--object sphere --material gloss --light-type point", "--kind mesh",
              {"camera": camera([0.5, -5.5, 1.5]), "deformation": [bend(30)],
               "effects": {"ground": {"height": -1.1}},
               "lights": [lamp([2, -2, 2], [-2, -2, 2], [10, 9, 8]), lamp([-3, 0, 1], [-3, 1, 3], [3, 4, 5])],
               "samples": 4}),
    "ring": ("plastic ring, guided, twisted and bent, a studio map that turns and a lamp",
             "--object torus --material plastic", "--kind mesh",
             {"camera": camera([0, -3.6, 2.8]), "deformation": [twist(40), bend(40)],
              "lights": [STUDIO, lamp([2, -2, 1.5], [-2, 2, 1.5], [14, 12, 9])],
              "accuracy": {"shadow_rays": 16}, "samples": 4}),
    "surfels": ("surfels of a velvet capsule, plain, twisted, a studio map, through a wide lens",
                "--object capsule --material velvet", "--kind surfels --fit off",
                {"camera": camera([0.5, -5.5, 1.5]), "deformation": [twist(35)],
                 "effects": {"depth_of_field": {"aperture": 0.08, "focus": 5.0}}, "lights": [STUDIO], "samples": 16}),
    "sway": ("plastic ball, guided, a mesh from files that sways, a lamp close to it and a sky",
             "--object sphere --material plastic", "--kind mesh --shape model.ply",
             {"camera": camera([0.5, -5.5, 1.5]), "deformation": [{"type": "sequence", "file": "sway.####.ply"}],
              "lights": [lamp([1.6, -1.2, 0.5], [-1, -1.7, 0.5], [2, 2, 2]),
                         {"type": "environment", "map": "../sky.hdr", "samples": 64}],
              "samples": 2}),
}


def prepare(name, work):
    """The scene's file and its field."""
    _, synth, model, scene = SCENES[name]
    folder = work / name
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "scene.json"
    if not file.exists():
        run("synth", "-o", folder / "capture", *synth.split(), "--views", 32, "--lights", 48, "--size", 96)
        run("acquire", folder / "capture", "-o", folder / "x.srf")
        words = [folder / "capture" / w if w.endswith(".ply") else w for w in model.split()]
        run("model", folder / "x.srf", *words)
        if name == "sway":
            write_swaying_meshes(folder / "capture" / "model.ply", folder, LAST + 1)
        file.write_text(json.dumps({**scene, "srf": str(folder / "x.srf"), "frames": f"0-{LAST}"}, indent=1))
    return file


def frames_of(pattern, *words):
    """Renders where the frames are not there; their files."""
    files = [pattern.with_name(pattern.name.replace("####", f"{frame:04d}")) for frame in range(LAST + 1)]
    if not all(file.exists() for file in files):
        run("render", *words, "-o", pattern)
    return files


def worst(pictures, truths):
    return max(json.loads(run("compare", a, b, "--json"))["relative_error_mean"] for a, b in zip(pictures, truths))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--budget", default="3m", help="of each study")
    parser.add_argument("--scene", nargs="+", choices=SCENES, default=list(SCENES))
    options = parser.parse_args()
    work = options.output.resolve()
    work.mkdir(parents=True, exist_ok=True)
    write_sky(work / "sky.hdr")
    print("| scene | target | promised | found, worst of 17 frames | times as fast as exact |")
    print("|---|---|---|---|---|")
    missed, trivial = 0, 0
    for name in options.scene:
        file = prepare(name, work)
        folder = file.parent
        record = folder / "study" / "study.json"
        if not record.exists():
            run("study", file, "-o", folder / "study", "--budget", options.budget)
        study = json.loads(record.read_text())
        settings = {json.dumps(s["set"]): s for s in study["settings"] if "memory_bytes" not in s}
        quality = ("--quality", record, "--target-error")
        exact = frames_of(folder / "exact.####.exr", file, *quality, 0)
        lights = [value for key, value in study["exact"].items() if key.startswith("/lights/")]
        print(f"| {SCENES[name][0]} | exact: {study['exact']['/samples']} samples"
              + (f", {lights[0] or 'all'} lights of the map" if lights else "") + " | | | 1 |", flush=True)
        for target in TARGETS:
            pictures = frames_of(folder / f"{target:g}.####.exr", file, *quality, target)
            chosen = min((s for s in settings.values() if s["set"] in study["front"] and s["promise"]["error"] <= target),
                         key=lambda s: s["seconds_worst"])
            found = worst(pictures, exact)
            missed += not found <= target
            trivial += found == 0
            times = settings[json.dumps(study["exact"])]["seconds_worst"] / chosen["seconds_worst"]
            print(f"| | {100 * target:g} % | {100 * chosen['promise']['error']:.3g} % | {100 * found:.3g} % "
                  f"| {times:.3g} |", flush=True)
    print(f"\n{missed} targets missed; {trivial} kept by the exact setting itself, or one equal to it, which proves nothing.")
    return missed > 0


sys.exit(main())
