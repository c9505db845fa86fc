#!/usr/bin/env python3
"""Measures the whole way, photographs to relit deformed pictures, on synthetic captures against their exact pictures.

    tools/accuracy_table.py -o WORK        writes doc/accuracy.md and doc/images/accuracy_*.png

Everything is done with the project's own commands (synth, acquire, model, render, compare). WORK keeps every step; a
step is done again only when its commands or its programs have changed, so an interrupted run goes on where it stopped.
In doc/accuracy.md only the blocks between the `measured` marks are written; the words around them stay.
"""
import argparse
import hashlib
import json
import math
import os
import random
import re
import statistics
import struct
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OBJECTS = ("sphere", "torus", "bumpy")
MATERIALS = ("lambert", "plastic", "conductor", "velvet")
VIEWS, LIGHTS, CAPTURE_SIZE, SCENE_SIZE = 64, 64, 128, 192
BEND = 60  # degrees of twist or bend over the object's extent along x
EYE = (2.0, -3.6, 2.2)  # towards the held-out view; as far from the object as the capture's cameras
DIRECTIONS = ((-0.3, -0.5, 0.8), (0.8, -0.5, 0.2))  # to the two held-out lights
NOISE = 0.003  # of the point cloud, standard deviation in parts of the object's diameter
CLOUD_POINTS = 40000
SLICES = (-22.5, -7.5, 7.5, 22.5)  # the middles of quarters of -30..30 degrees

# Frames of every scene: two lights of each, one after the other.
STATES = ("rest", "twist", "bend")
MAIN_FRAMES = range(6)
TURNED = {"twist": range(6, 14), "bend": range(14, 22)}  # at rest, from where the slices are lit and seen


def unit(v):
    n = math.sqrt(sum(x * x for x in v))
    return [x / n for x in v]


def degrees_between(a, b):
    return math.degrees(math.acos(max(-1.0, min(1.0, sum(x * y for x, y in zip(unit(a), unit(b)))))))


def turned(v, axis, degrees):
    """v turned about the x or the y axis."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x, y, z = v
    return [x, c * y - s * z, s * y + c * z] if axis == "x" else [c * x + s * z, y, c * z - s * x]


class Ply:
    """Positions and normals of a mesh that srf wrote."""

    def __init__(self, file):
        data = file.read_bytes()
        header, body = data.split(b"end_header\n", 1)
        count = int(re.search(rb"element vertex (\d+)", header)[1])
        self.vertices = list(struct.iter_unpack("<3d3f", body[: count * 36]))

    def extent(self, axis):
        values = [v[axis] for v in self.vertices]
        return max(values) - min(values)

    def diameter(self):
        return math.sqrt(sum(self.extent(a) ** 2 for a in range(3)))

    def write_noisy_cloud(self, file):
        rng = random.Random(1)
        sigma = NOISE * self.diameter()
        points = rng.sample(self.vertices, CLOUD_POINTS)
        out = ["ply\nformat ascii 1.0", f"element vertex {len(points)}"]
        out += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")] + ["end_header"]
        for p in points:
            noisy = [x + rng.gauss(0, sigma) for x in p[:3]]
            out.append(" ".join(f"{x:.6f}" for x in (*noisy, *p[3:])))
        file.write_text("\n".join(out) + "\n")


class Bench:
    def __init__(self, srf, work):
        self.srf, self.work = srf.resolve(), work.resolve()
        self.identity = {}

    def program(self, command):
        if command not in self.identity:
            file = self.srf.with_name(f"srf-{command}")
            self.identity[command] = hashlib.sha256(file.read_bytes()).hexdigest()
        return self.identity[command]

    def run(self, *arguments):
        line = [str(self.srf), *map(str, arguments)]
        done = subprocess.run(line, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{' '.join(line)}\nended with {done.returncode}:\n{done.stderr}")
        return done.stdout

    def step(self, mark, lines, inputs=()):
        """Runs the command lines unless `mark` says that the same programs ran them on the same inputs."""
        stamp = json.dumps([[self.program(str(l[0])) for l in lines], [list(map(str, l)) for l in lines],
                            [i.read_text() for i in inputs]])
        stamp = hashlib.sha256(stamp.encode()).hexdigest()
        if mark.exists() and mark.read_text() == stamp:
            return
        print(" ".join(map(str, lines[-1])).replace(str(self.work) + "/", ""), file=sys.stderr, flush=True)
        for line in lines:
            self.run(*line)
        mark.write_text(stamp)


class Case:
    """One capture and all that is measured on it."""

    def __init__(self, bench, shape, material):
        self.bench, self.shape, self.material = bench, shape, material
        self.folder = bench.work / f"{shape}_{material}"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.capture, self.field, self.scene = (self.folder / n for n in ("capture", "field.srf", "scene.json"))
        bench.step(self.folder / "capture.done",
                   [["synth", "-o", self.capture, "--object", shape, "--material", material, "--views", VIEWS,
                     "--lights", LIGHTS, "--size", CAPTURE_SIZE, "--supersampling", 3]])
        bench.step(self.folder / "field.done", [["acquire", self.capture, "-o", self.field]],
                   [self.folder / "capture.done"])
        self.mesh = Ply(self.capture / "model.ply")
        self.transforms = json.loads((self.capture / "transforms.json").read_text())
        self.write_scene()

    def write_scene(self):
        extent = self.mesh.extent(0)
        rate = BEND / extent
        camera = [row[3] for row in self.transforms["frames"][0]["transform_matrix"][:3]]
        distance = math.sqrt(sum(x * x for x in camera))
        turns = {f: (axis, a) for state, axis in (("twist", "x"), ("bend", "y"))
                 for f, a in zip(TURNED[state], [a for a in SLICES for _ in DIRECTIONS])}
        frames = range(TURNED["bend"][-1] + 1)
        eye = [distance * x for x in unit(EYE)]
        held = lambda keys: {"keys": keys, "interpolation": "step"}
        # A slice that the deformation turns by an angle is lit and seen from directions turned back by it.
        from_rest = lambda v: [[f, turned(v(f), turns[f][0], -turns[f][1]) if f in turns else v(f)] for f in frames]
        scene = {
            "camera": {"w": SCENE_SIZE, "h": SCENE_SIZE, "vfov": 30,
                       "look_at": {"eye": held(from_rest(lambda f: eye)), "target": [0, 0, 0],
                                   "up": held(from_rest(lambda f: [0, 0, 1]))}},
            "deformation": [
                {"type": "twist", "axis": [1, 0, 0], "degrees_per_unit": held([[0, 0], [2, rate], [4, 0]])},
                {"type": "bend", "axis": [1, 0, 0], "toward": [0, 0, 1], "range": [-extent / 2, extent / 2],
                 "degrees_per_unit": held([[0, 0], [4, rate], [6, 0]])},
            ],
            "lights": [{"type": "directional", "irradiance": [3, 3, 3],
                        "direction": held(from_rest(lambda f: list(DIRECTIONS[f % 2])))}],
            "frames": f"0-{frames[-1]}", "samples": 4, "interpolation": "plain",
        }
        text = json.dumps(scene, indent=1)
        if not self.scene.exists() or self.scene.read_text() != text:
            self.scene.write_text(text)

    def frames(self, name):
        return str(self.folder / f"{name}.####.exr")

    def file(self, name, frame):
        return self.folder / f"{name}.{frame:04d}.exr"

    def rendered(self, name, model, frames, settings=()):
        """Pictures `name` with the model that these options make."""
        changes = [x for s in settings for x in ("--set", s)]
        span = f"{frames[0]}-{frames[-1]}"
        self.bench.step(self.folder / f"{name}.done",
                        [["model", self.field, *model],
                         ["render", self.scene, "--srf", self.field, "--set", "/interpolation=plain", *changes,
                          "--frames", span, "-o", self.frames(name)]],
                        [self.scene, self.folder / "field.done"])

    def reference(self, name, shadows, frames, settings=()):
        changes = [x for s in settings for x in ("--set", s)]
        self.bench.step(self.folder / f"{name}.done",
                        [["synth", "--reference", self.scene, "--capture", self.capture, "--shadows", shadows,
                          "--samples", 16, *changes, "--frames", f"{frames[0]}-{frames[-1]}", "-o",
                          self.frames(name)]],
                        [self.scene, self.folder / "capture.done"])

    def compared(self, name, reference, frames):
        """The figures of these frames; measured once."""
        store = self.folder / f"{name}.{reference}.json"
        key = hashlib.sha256("".join([self.bench.program("compare")] + [
            (self.folder / f"{n}.done").read_text() for n in (name, reference)]).encode()).hexdigest()
        known = json.loads(store.read_text()) if store.exists() else {}
        if known.get("key") != key:
            known = {"key": key}
        for f in frames:
            if str(f) not in known:
                truth = self.file(reference, f)
                known[str(f)] = json.loads(
                    self.bench.run("compare", "--json", "--mask", truth, self.file(name, f), truth))
        store.write_text(json.dumps(known))
        return [known[str(f)] for f in frames]

    def figure(self, name, reference, frames, kind="in_psnr"):
        return statistics.mean(d[kind] for d in self.compared(name, reference, frames))

    def state(self, name, reference, state, kind="in_psnr"):
        first = 2 * STATES.index(state)
        return self.figure(name, reference, [first, first + 1], kind)

    def loss(self, state, name="hull", reference="none"):
        return self.state(name, reference, "rest") - self.state(name, reference, state)


def mse(d):
    return d["peak"] ** 2 * 10 ** (-d["in_psnr"] / 10)


class Explained:
    """Where a loss by deformation alone comes from: the same loss with one thing changed at a time."""

    def __init__(self, case, state):
        first = 2 * STATES.index(state)
        bent = case.compared("hull", "none", [first, first + 1])
        rest = case.compared("hull", "none", [0, 1])
        self.loss = case.loss(state)
        self.peak = statistics.mean(20 * math.log10(r["peak"] / b["peak"]) for r, b in zip(rest, bent))
        # The rest pose seen and lit as the slices of the deformed object are: what the directions alone cost.
        case.rendered(f"turned_{state}", [], TURNED[state])
        case.reference(f"none_turned_{state}", "none", TURNED[state])
        slices = case.compared(f"turned_{state}", f"none_turned_{state}", TURNED[state])
        self.spread = [d["in_psnr"] for d in slices]
        directions = [statistics.mean(mse(d) for d in slices[light::2]) for light in range(2)]
        self.directions = statistics.mean(
            10 * math.log10(m * r["peak"] ** 2 / (mse(r) * b["peak"] ** 2)) for m, r, b in zip(directions, rest, bent))
        self.captured = case.loss(state, reference="captured")
        case.rendered("true", ["--shape", case.capture / "model.ply"], MAIN_FRAMES)
        self.true_mesh = case.loss(state, "true")
        polar = ["/accuracy/frame=polar"]
        case.rendered("polar", [], MAIN_FRAMES, polar)
        case.reference("none_polar", "none", MAIN_FRAMES, polar)
        self.polar = case.loss(state, "polar", "none_polar")


def table(head, rows):
    out = ["| " + " | ".join(head) + " |", "|" + "|".join("---" if i < 3 else "---:" for i in range(len(head))) + "|"]
    return out + ["| " + " | ".join(row) + " |" for row in rows]


def db(x):
    return "-" if x is None else f"{x:.1f}"


def main_table(cases):
    rows = []
    for case in cases:
        for state in STATES:
            at = lambda reference, kind: case.state("hull", reference, state, kind)
            rows.append([case.shape, case.material, state, "" if state == "rest" else db(case.loss(state)),
                         *(db(at(r, "in_psnr")) for r in ("none", "captured", "deformed")),
                         *(f"{at(r, k):.3f}" for k in ("in_ssim", "in_flip") for r in ("none", "deformed"))])
    for state in STATES:
        at = lambda reference, kind: statistics.mean(c.state("hull", reference, state, kind) for c in cases)
        loss = "" if state == "rest" else db(statistics.mean(c.loss(state) for c in cases))
        rows.append(["**mean**", "", state, loss,
                     *(db(at(r, "in_psnr")) for r in ("none", "captured", "deformed")),
                     *(f"{at(r, k):.3f}" for k in ("in_ssim", "in_flip") for r in ("none", "deformed"))])
    return table(["object", "material", "pose", "loss", "PSNR none", "PSNR captured", "PSNR deformed", "SSIM none",
                  "SSIM deformed", "FLIP none", "FLIP deformed"], rows)


def loss_table(cases, least):
    rows = []
    for case in cases:
        for state in STATES[1:]:
            if case.loss(state) > least:
                e = Explained(case, state)
                rows.append([case.shape, case.material, state, db(case.state("hull", "none", "rest")),
                             db(case.state("hull", "none", state)),
                             f"{statistics.mean(e.spread):.1f} ({min(e.spread):.1f} to {max(e.spread):.1f})",
                             db(e.loss), db(e.directions), db(e.peak),
                             db(e.captured), db(e.true_mesh), db(e.polar)])
    if not rows:
        return [f"No case loses more than {least:g} dB."]
    return table(["object", "material", "pose", "PSNR at rest", "PSNR deformed", "PSNR at rest, turned", "loss",
                  "directions alone", "peak alone", "against captured shadows",
                  "with the true mesh", "polar frame"], rows)


def model_table(cases):
    rows = []
    for case in cases:
        true = case.capture / "model.ply"
        cloud = case.folder / "cloud.ply"
        if not cloud.exists():
            case.mesh.write_noisy_cloud(cloud)
        models = {"hull": [], "surfels": ["--kind", "surfels"], "true": ["--shape", true],
                  "cloud": ["--shape", cloud]}
        if case.shape in ("sphere", "cylinder", "torus"):
            models["parametric"] = ["--shape", case.shape]
        for name, options in models.items():
            if name != "hull":
                case.rendered(name, options, MAIN_FRAMES)
        for state in STATES:
            rows.append([case.shape, case.material, state,
                         *(db(case.state(n, "none", state) if n in models else None)
                           for n in ("hull", "surfels", "parametric", "true", "cloud"))])
    return table(["object", "material", "pose", "hull", "hull as surfels", "parametric", "scan mesh", "noisy points"],
                 rows)


def setup_text(case):
    lights = [l["direction"] for l in case.transforms["lights"]]
    views = {f["view"]: [row[3] for row in f["transform_matrix"][:3]] for f in case.transforms["frames"]}
    near = lambda d, all_: min(degrees_between(d, x) for x in all_)
    extents = {}
    for shape in (*OBJECTS, "cylinder"):
        extents[shape] = json.loads((case.bench.work / f"{shape}_plastic/scene.json").read_text())
    rates = ", ".join(f"{s} {e['deformation'][0]['degrees_per_unit']['keys'][1][1]:.2f}" for s, e in extents.items())
    return [f"{VIEWS} views and {LIGHTS} directional lights all around, {CAPTURE_SIZE} x {CAPTURE_SIZE} pixels; "
            f"pictures of {SCENE_SIZE} x {SCENE_SIZE} from as far as the photographs, so 1.5 times as fine, with 4 "
            f"samples a pixel, the exact ones with 16. The held-out view is "
            f"{near(EYE, views.values()):.1f} degrees from the nearest captured one, the lights "
            f"{' and '.join(f'{near(d, lights):.1f}' for d in DIRECTIONS)} degrees. Twist about x, bend along x "
            f"towards z over the object's whole extent, both by {BEND} degrees from end to end (`degrees_per_unit`: "
            f"{rates}). Every figure is the mean of the two lights."]


def contact_sheets(cases, images):
    """Rows: materials. Columns: rest, twist, bend, each rendered, exact without and with cast shadows; second light."""
    images.mkdir(parents=True, exist_ok=True)
    for shape in OBJECTS:
        tiles = []
        of_shape = [c for c in cases if c.shape == shape]
        for case in of_shape:
            white = case.compared("hull", "none", [1])[0]["peak"]
            for i in range(len(STATES)):
                for name in ("hull", "none", "deformed"):
                    tile = case.folder / f"tile_{name}_{i}.tif"
                    subprocess.run(["oiiotool", case.file(name, 2 * i + 1), "--ch", "R,G,B", "--mulc", str(0.9 / white),
                                    "--clamp:min=0:max=1", "--powc", str(1 / 2.2), "--resize", "96x96", "-d", "uint8",
                                    "-o", tile], check=True)
                    tiles.append(tile)
        subprocess.run(["oiiotool", *tiles, f"--mosaic:pad=2", f"{3 * len(STATES)}x{len(of_shape)}", "-d", "uint8",
                        "--compression", "zip:9", "-o", images / f"accuracy_{shape}.png"], check=True)


def write_document(file, blocks):
    text = file.read_text()
    for name, lines in blocks.items():
        mark = f"<!-- measured: {name} -->"
        pattern = re.compile(re.escape(mark) + r".*?<!-- end -->", re.S)
        if not pattern.search(text):
            sys.exit(f"{file}: found no block '{mark}' ... '<!-- end -->'; put it back where its figures belong")
        text = pattern.sub(lambda _: "\n".join([mark, "", *lines, "", "<!-- end -->"]), text)
    file.write_text(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", metavar="WORK", type=Path, required=True, help="folder of captures, fields and pictures")
    parser.add_argument("--srf", type=Path, default=ROOT / "build/release/apps/srf", help="the program to measure")
    parser.add_argument("--doc", type=Path, default=ROOT / "doc", help="where accuracy.md and images/ are")
    parser.add_argument("--explain", metavar="DB", type=float, default=3, help="losses from here on are taken apart")
    options = parser.parse_args()
    if not options.srf.exists():
        parser.error(f"{options.srf} is not there; build it (tools/test.sh) or name it with --srf")
    os.nice(10)
    bench = Bench(options.srf, options.o)

    cases = [Case(bench, shape, material) for shape in OBJECTS for material in MATERIALS]
    cylinder = Case(bench, "cylinder", "plastic")
    for case in (*cases, cylinder):
        case.rendered("hull", [], MAIN_FRAMES)
        for shadows in ("none", "captured", "deformed"):
            case.reference(shadows, shadows, MAIN_FRAMES)
    contact_sheets(cases, options.doc / "images")
    others = [c for c in cases if c.material == "plastic"] + [cylinder]
    write_document(options.doc / "accuracy.md",
                   {"setup": setup_text(cases[0]), "table": main_table(cases),
                    "losses": loss_table(cases, options.explain), "models": model_table(others)})


if __name__ == "__main__":
    main()
