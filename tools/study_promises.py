#!/usr/bin/env python3
"""Does a setting that `srf study` recommends keep its promise where it was not measured?

    tools/study_promises.py STUDY/ -o WORK [--error 0.01 0.003 0.001]

Renders what the study did not look at (other frames of its scene, the camera moved, the lights turned) with the setting
that `srf render --quality` takes for each target and all-exact, at the scene's full size, and compares both. Prints a
table: promised and found error and time, and how many at each target keep the error within 20 % and the time within
25 %. Steps whose pictures are there are not done again. For honest times the machine should do nothing else.
"""
import argparse
import hashlib
import json
import math
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SRF = ROOT / "build/release/apps/srf"


def run(*words):
    done = subprocess.run([str(SRF), *map(str, words)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"srf {words[0]}: {done.stderr.strip()[-500:]}")
    return done.stdout


def turned(vector, degrees):
    a = math.radians(degrees)
    x, y, z = vector
    return [x * math.cos(a) - y * math.sin(a), x * math.sin(a) + y * math.cos(a), z]


def map_vector(value, turn):
    """A vector of the scene, keyed or not, turned."""
    if isinstance(value, dict):
        return {**value, "keys": [[frame, turn(v)] for frame, v in value["keys"]]}
    return turn(value)


def variations(scene, studied):
    """(name, scene, frame) of ten situations that the study did not see."""
    first, last = (scene["frames"].split("-") + [scene["frames"]])[:2]
    first, last = int(first), int(last.split("x")[0])
    others = [f for f in range(first, last + 1) if f not in studied]
    at = [others[(2 * i + 1) * len(others) // 20] for i in range(10)]
    for i in range(4):
        yield f"frame {at[i]}", scene, at[i]
    for i, degrees in zip(range(4, 7), (25, -60, 140)):
        moved = json.loads(json.dumps(scene))
        look = moved["camera"]["look_at"]
        look["eye"] = map_vector(look["eye"], lambda v: turned(v, degrees))
        yield f"camera {degrees:+d} degrees, frame {at[i]}", moved, at[i]
    for i, degrees in zip(range(7, 10), (35, -80, 150)):
        moved = json.loads(json.dumps(scene))
        for light in moved["lights"]:
            for key in ("direction", "position"):
                if key in light:
                    light[key] = map_vector(light[key], lambda v: turned(v, degrees))
            if light["type"] == "environment":
                old = light.get("rotation", 0)
                light["rotation"] = {**old, "keys": [[f, v + degrees] for f, v in old["keys"]]} \
                    if isinstance(old, dict) else old + degrees
        yield f"lights {degrees:+d} degrees, frame {at[i]}", moved, at[i]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--error", type=float, nargs="+", default=[0.01, 0.003, 0.001])
    options = parser.parse_args()
    study = json.loads((options.study / "study.json").read_text())
    file = Path(study["scene"])
    scene = json.loads(file.read_text())
    for light in scene["lights"]:
        if "map" in light:
            light["map"] = str((file.parent / light["map"]).resolve())
    for step in scene.get("deformation", []):
        if "file" in step:
            step["file"] = str((file.parent / step["file"]).resolve())
    scene["srf"] = str(Path(study["field"]).resolve())
    options.output.mkdir(parents=True, exist_ok=True)

    front = [s for s in study["settings"] if s["set"] in study["front"] and "memory_bytes" not in s]
    front.sort(key=lambda s: s["seconds_worst"])
    exact = study["exact"]
    print("| target | what was not studied | error, promised | found | seconds, promised | found |")
    print("|---|---|---|---|---|---|")
    counts = {target: [0, 0, 0] for target in options.error}  # cases, error kept, time kept
    for number, (name, changed, frame) in enumerate(variations(scene, study["frames"] + study["further_frames"])):
        path = options.output / f"{number}.json"
        path.write_text(json.dumps(changed))

        def render(keys):
            tag = hashlib.sha256(json.dumps([keys, changed], sort_keys=True).encode()).hexdigest()[:12]
            out = options.output / f"{number}-{tag}.{frame:04d}.exr"
            log = out.with_suffix(".log")
            if not (out.exists() and log.exists()):
                # Twice: the first frame opens files and fills the cache.
                words = [w for k, v in keys.items() for w in ("--set", f"{k}={json.dumps(v)}")]
                log.write_text(run("render", path, "--frames", f"{frame},{frame}", "-o",
                                   options.output / f"{number}-{tag}.####.exr", *words))
            return out, float(re.findall(r"\.exr +([0-9.e+-]+) s$", log.read_text(), re.M)[-1])

        truth, _ = render(exact)
        for target in options.error:
            chosen = next((s for s in front if s["promise"]["error"] <= target), None)
            if chosen is None:
                continue
            picture, seconds = render(chosen["set"])
            found = json.loads(run("compare", picture, truth, "--json"))["relative_error_mean"]
            promise = chosen["promise"]
            counts[target][0] += 1
            counts[target][1] += found <= 1.2 * promise["error"]
            counts[target][2] += seconds <= 1.25 * promise["seconds"]
            print(f"| {100 * target:g} % | {name} | {100 * promise['error']:.3g} % | {100 * found:.3g} % | "
                  f"{promise['seconds']:.3g} | {seconds:.3g} |", flush=True)
    print()
    for target, (cases, error, time) in counts.items():
        print(f"{100 * target:g} %: of {cases} error at most 1.2 times the promise {error}, "
              f"time at most 1.25 times the promise {time}.")


main()
