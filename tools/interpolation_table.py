#!/usr/bin/env python3
"""Measures plain and guided interpolation on synthetic captures of every kind against their exact pictures.

    tools/interpolation_table.py -o WORK                    writes doc/interpolation.md's tables and doc/interpolation.csv
    tools/interpolation_table.py -o WORK --only wax,glass   prints the rows of these captures alone

Everything is done with the project's own commands (synth, acquire, model, render, compare). WORK keeps every step; a
step is done again only when its commands or its programs have changed. In doc/interpolation.md only the blocks between
the `measured` marks are written; the words around them stay.
"""
import argparse
import csv
import dataclasses
import hashlib
import json
import statistics
import sys
from multiprocessing.pool import ThreadPool
from pathlib import Path

from accuracy_table import Bench, Ply, ROOT, degrees_between, table, unit, write_document

VIEWS, LIGHTS, SIZE, SCENE_SIZE = 40, 64, 56, 64
SAMPLES, TRUE_SAMPLES = 4, 16  # a pixel
CELLS = 40  # of the true mesh along its longest side: an edge is about a pixel of a photograph
TURN = 60  # degrees of twist or bend over the object's extent along x
EYES = ((2.0, -3.6, 2.2), (-3.1, -2.4, 1.5))  # towards the held-out views; as far as the capture's cameras
HELD_OUT = ((-0.3, -0.5, 0.8), (0.8, -0.5, 0.2))  # to the held-out lights
NEAR_CAPTURED = ((0.3, -0.6, 0.7), (-0.8, -0.5, 0.3))  # the captured lights nearest to these
NEAR = (-0.9, -1.2, 1.1)  # a point light, in radii of the object
ENVIRONMENT = ROOT / "tools/demo/studio.exr"
CASES = ("view 1", "view 2", "light", "view + light 1", "view + light 2", "near light", "sky", "rigid", "twist", "bend")


@dataclasses.dataclass
class Kind:
    name: str
    object: str
    material: str
    shapes: tuple = ("mesh", "hull")  # the true surface as a scan; the visual hull
    options: dict = dataclasses.field(default_factory=dict)  # of srf synth; None: a flag
    cases: tuple = CASES
    fitted: bool = True  # False: too few lights for a model; every way but plain would be refused


KINDS = (
    Kind("plastic", "torus", "plastic"),
    Kind("metal", "torus", "conductor"),
    Kind("diffuse", "bumpy", "lambert"),
    Kind("velvet", "capsule", "velvet", ("mesh",)),
    Kind("noise", "torus", "plastic", ("mesh", "hull"), {"--noise": 0.02}),
    Kind("32 lights", "torus", "plastic", ("mesh", "hull"), {"--lights": 32}),
    Kind("point lights", "torus", "plastic", ("mesh",), {"--light-type": "point"}),
    Kind("turntable", "torus", "plastic", ("mesh",), {"--rig": "turntable", "--views": 48, "--lights": 32}),
    Kind("missing", "torus", "plastic", ("mesh",), {"--missing": 0.3}),
    Kind("concave", "bowl", "lambert"),
    Kind("ball on plate", "ball_on_plate", "plastic"),
    Kind("interreflection", "bowl", "white", ("mesh", "hull"), {"--interreflection": None}),
    Kind("wax slab", "slab", "wax"),
    Kind("wax", "bumpy", "wax", ("mesh",)),
    Kind("mixed", "torus", "mixed"),
    Kind("saturated", "torus", "plastic", ("mesh",), {"--saturate": 0.25}),
    Kind("narrow lobe", "torus", "gloss"),
    Kind("glass", "ball_on_plate", "glass"),
    Kind("one light", "torus", "plastic", ("mesh",), {"--lights": 1}, CASES[:1], False),
)


def make_model(bench, capture, work, shape):
    """work/SHAPE.srf: the field of the capture, with a model of its true surface or of its hull."""
    field, source = work / f"{shape}.srf", capture / "model.ply" if shape == "mesh" else "hull"
    bench.step(work / f"model.{shape}.done", [["acquire", capture, "-o", field], ["model", field, "--shape", source]],
               [f for f in [work / "capture.done"] if f.exists()])


class Capture:
    """One capture, its scenes and their exact pictures."""

    def __init__(self, bench, kind):
        self.bench, self.kind = bench, kind
        self.pool = ThreadPool(4)  # pictures compared at once
        self.folder = bench.work / kind.name.replace(" ", "_")
        self.folder.mkdir(parents=True, exist_ok=True)
        self.capture = self.folder / "capture"
        options = {"--views": VIEWS, "--lights": LIGHTS, "--size": SIZE, "--supersampling": 2, "--mesh-cells": CELLS,
                   **kind.options}
        bench.step(self.folder / "capture.done",
                   [["synth", "-o", self.capture, "--object", kind.object, "--material", kind.material,
                     *(x for option in options.items() for x in option if x is not None)]])
        self.transforms = json.loads((self.capture / "transforms.json").read_text())
        self.scenes = self.write_scenes()

    def frames(self, scene):
        return [i for i, name in enumerate(self.scenes[scene]) if name in self.kind.cases]

    def light(self, direction):
        """A light of the capture's kind in this direction, as far as its lights."""
        first = self.transforms["lights"][0]
        if first["type"] == "directional":
            return "direction", unit(direction)
        distance = sum(x * x for x in first["position"]) ** 0.5
        return "position", [distance * x for x in unit(direction)]

    def write_scenes(self):
        """Names of the frames by scene; the scenes are files."""
        mesh = Ply(self.capture / "model.ply")
        extent = mesh.extent(0)
        radius = max(sum(x * x for x in v[:3]) for v in mesh.vertices) ** 0.5
        rate = TURN / extent
        center = lambda frame: [row[3] for row in frame["transform_matrix"][:3]]
        views = {f["view"]: center(f) for f in self.transforms["frames"]}.values()
        distance = sum(x * x for x in next(iter(views))) ** 0.5
        eyes = [[distance * x for x in unit(e)] for e in EYES]
        captured_eye = min(views, key=lambda v: degrees_between(v, EYES[0]))
        key = self.light(HELD_OUT[0])[0]
        captured = [min((l[key] for l in self.transforms["lights"]), key=lambda x: degrees_between(x, d))
                    for d in NEAR_CAPTURED]
        held_out = [self.light(d)[1] for d in HELD_OUT]
        first = self.transforms["lights"][0]
        strength = {"irradiance": [3, 3, 3]} if key == "direction" else {
            "intensity": [3 * x for x in first["intensity"]]}
        held = lambda values: {"keys": list(map(list, enumerate(values))), "interpolation": "step"}

        def scene(name, frames, eye, lights, deformation):
            # Values of one entry each frame.
            content = {
                "camera": {"w": SCENE_SIZE, "h": SCENE_SIZE, "vfov": 30,
                           "look_at": {"eye": held(eye), "target": [0, 0, 0], "up": [0, 0, 1]}},
                "deformation": deformation, "lights": lights, "frames": f"0-{len(frames) - 1}", "samples": SAMPLES,
            }
            if not deformation:
                del content["deformation"]
            text = json.dumps(content, indent=1)
            file = self.folder / f"{name}.json"
            if not file.exists() or file.read_text() != text:
                file.write_text(text)
            return frames

        one = lambda values: [{"type": "directional" if key == "direction" else "point", key: held(values), **strength}]
        c, s = 0.766, 0.643  # 40 degrees about x
        rigid = {"type": "affine", "matrix": [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]]}
        near = [radius * x for x in NEAR]
        return {
            "rest": scene("rest", CASES[:5], [eyes[0], eyes[1], captured_eye, eyes[0], eyes[1]],
                          one([captured[0], captured[1], held_out[0], held_out[0], held_out[1]]), []),
            "near": scene("near", CASES[5:6], eyes[:1],
                          [{"type": "point", "position": near, "intensity": [3 * sum(x * x for x in near)] * 3}], []),
            "sky": scene("sky", CASES[6:7], eyes[:1],
                         [{"type": "environment", "map": str(ENVIRONMENT), "samples": 0}], []),
            "rigid": scene("rigid", CASES[7:8], eyes[:1], one(held_out[:1]), [rigid]),
            "deformed": scene("deformed", CASES[8:], [eyes[0], eyes[0]], one([held_out[0], held_out[0]]), [
                {"type": "twist", "axis": [1, 0, 0], "degrees_per_unit": held([rate, 0])},
                {"type": "bend", "axis": [1, 0, 0], "toward": [0, 0, 1], "range": [-extent / 2, extent / 2],
                 "degrees_per_unit": held([0, rate])}]),
        }

    def exact(self, scene, name, samples):
        frames = self.frames(scene)
        self.bench.step(self.folder / f"{scene}.{name}.done",
                        [["synth", "--reference", self.folder / f"{scene}.json", "--capture", self.capture,
                          "--samples", samples, "--frames", f"{frames[0]}-{frames[-1]}", "-o",
                          self.folder / f"{scene}.{name}.####.exr"]],
                        [self.folder / f"{scene}.json", self.folder / "capture.done"])

    def rendered(self, scene, shape, way):
        frames = self.frames(scene)
        self.bench.step(self.folder / f"{scene}.{shape}.{way}.done",
                        [["render", self.folder / f"{scene}.json", "--srf", self.folder / f"{shape}.srf",
                          "--set", f"/interpolation={way}", "--frames", f"{frames[0]}-{frames[-1]}", "-o",
                          self.folder / f"{scene}.{shape}.{way}.####.exr"]],
                        [self.folder / f"{scene}.json", self.folder / f"model.{shape}.done"])

    def compared(self, image, truth):
        """What compare says; kept beside the image until one of the two changes."""
        stamp = hashlib.sha256(image.read_bytes() + truth.read_bytes()).hexdigest() + self.bench.program("compare")
        kept = image.with_suffix(".compare")
        if kept.exists() and kept.read_text().split("\n")[0] == stamp:
            return json.loads(kept.read_text().split("\n")[1])
        found = self.bench.run("compare", "--json", "--mask", truth, image, truth).strip()
        kept.write_text(f"{stamp}\n{found}")
        return json.loads(found)

    def measure(self, shape, ways):
        """Rows of the table: one a case."""
        make_model(self.bench, self.capture, self.folder, shape)
        rows = []
        for scene in self.scenes:
            if not self.frames(scene):
                continue
            self.exact(scene, "truth", TRUE_SAMPLES)
            self.exact(scene, "exact", SAMPLES)
            for way in ways:
                self.rendered(scene, shape, way)
            for frame in self.frames(scene):
                truth = self.folder / f"{scene}.truth.{frame:04d}.exr"
                row = {"capture": self.kind.name, "object": self.kind.object, "material": self.kind.material,
                       "surface": shape, "case": self.scenes[scene][frame]}
                names = [*(f"{shape}.{way}" for way in ways), "exact"]
                images = [self.folder / f"{scene}.{name}.{frame:04d}.exr" for name in names]
                for name, found in zip(names, self.pool.map(lambda image: self.compared(image, truth), images)):
                    way = name.split(".")[-1]
                    row.update({f"{way} PSNR": found["in_psnr"], f"{way} FLIP": found["in_flip"],
                                f"{way} SSIM": found["in_ssim"]})
                    if found["nonfinite"]:
                        sys.exit(f"{scene} of {self.kind.name}, {name}: {found['nonfinite']} pixels are not finite")
                rows.append(row)
        return rows


def rendered_capture(bench, folder, shape, ways):
    """A capture made elsewhere, with cases/NAME/scene.json, reference*.exr and mask*.exr beside its folder."""
    capture, work = folder / "capture", bench.work / folder.name
    work.mkdir(parents=True, exist_ok=True)
    make_model(bench, capture, work, shape)
    rows = []
    for case in sorted((folder / "cases").iterdir()):
        truths = sorted(p for p in case.glob("reference*.exr") if "unshadowed" not in p.name)
        masks = sorted(case.glob("mask*.exr"))
        row = {"capture": folder.name, "surface": shape, "case": case.name}
        for way in ways:
            out = work / f"{case.name}.{shape}.{way}"
            bench.step(Path(f"{out}.done"), [["render", case / "scene.json", "--srf",
                                              work / f"{shape}.srf", "--set", f"/interpolation={way}", "-o", f"{out}.####.exr"]],
                       [work / f"model.{shape}.done"])
            frames = sorted(work.glob(f"{out.name}.*.exr"))
            found = [json.loads(bench.run("compare", "--json", "--mask", masks[min(i, len(masks) - 1)], f, t))
                     for i, (f, t) in enumerate(zip(frames, truths))]
            for figure in ("PSNR", "FLIP", "SSIM"):
                row[f"{way} {figure}"] = statistics.mean(d[f"in_{figure.lower()}"] for d in found)
        rows.append(row)
    return rows


def groups(rows):
    """Rows by capture and surface, in their order."""
    found = {}
    for row in rows:
        found.setdefault((row["capture"], row["surface"]), []).append(row)
    return found


def mean_table(rows, ways):
    out = []
    for (capture, surface), of in groups(rows).items():
        def mean(way, figure, digits):
            key = f"{way} {figure}"
            return f"{statistics.mean(r[key] for r in of):.{digits}f}" if key in of[0] else "-"

        line = [capture, surface, " ".join(dict.fromkeys(x for r in of for x in (r.get("object"), r.get("material"))
                                                         if x))]
        line += [mean(w, "PSNR", 1) for w in (*ways, "exact")]
        if "plain" in ways and "guided" in ways:
            gains = [(r["guided PSNR"] - r["plain PSNR"], r["case"]) for r in of if "guided PSNR" in r]
            line += [f"{statistics.mean(g for g, _ in gains):+.1f}", f"{min(gains)[0]:+.1f} {min(gains)[1]}"] if gains \
                else ["-", "-"]
        line += [mean(w, "FLIP", 3) for w in ways]
        out.append(line)
    head = ["capture", "surface", "object", *ways, "exact"]
    head += ["gain", "least gain"] if "plain" in ways and "guided" in ways else []
    return table(head + [f"FLIP {w}" for w in ways], out)


def case_table(rows, ways):
    out = []
    for (capture, surface), of in groups(r for r in rows if r["case"] in CASES).items():
        cell = {r["case"]: " / ".join(f"{r[f'{w} PSNR']:.1f}" if f"{w} PSNR" in r else "-" for w in ways) for r in of}
        out.append([capture, surface, *(cell.get(c, "-") for c in CASES)])
    return table(["capture", "surface", *CASES], out)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", metavar="WORK", type=Path, required=True, help="folder of captures, fields and pictures")
    parser.add_argument("--srf", type=Path, default=ROOT / "build/release/apps/srf", help="the program to measure")
    parser.add_argument("--doc", type=Path, default=ROOT / "doc", help="where interpolation.md is")
    parser.add_argument("--only", metavar="NAMES", default="", help="captures, joined by commas; prints, writes no page")
    parser.add_argument("--ways", default="plain,guided,model", help="interpolations to measure, joined by commas")
    parser.add_argument("--rendered", type=Path, action="append", default=[], metavar="FOLDER",
                        help="a capture made elsewhere: FOLDER/capture, FOLDER/cases/NAME/{scene.json,reference.exr,"
                             "mask.exr}")
    options = parser.parse_args()
    if not options.srf.exists():
        parser.error(f"{options.srf} is not there; build it (tools/test.sh) or name it with --srf")
    only = [n for n in options.only.split(",") if n]
    names = [k.name for k in KINDS] + [r.name for r in options.rendered]
    for name in only:
        if name not in names:
            parser.error(f"--only: found '{name}', expected some of: {', '.join(names)}")
    bench, ways, rows = Bench(options.srf, options.o), options.ways.split(","), []
    for kind in KINDS:
        if only and kind.name not in only:
            continue
        capture = Capture(bench, kind)
        for shape in kind.shapes:
            rows += capture.measure(shape, ways if kind.fitted else ["plain"])
    for folder in options.rendered:
        if not only or folder.name in only:
            for shape in ("mesh", "hull"):
                rows += rendered_capture(bench, folder.resolve(), shape, ways)
    means, cases = mean_table(rows, ways), case_table(rows, ways)
    print("\n".join([*means, "", *cases]))
    if only:
        return
    write_document(options.doc / "interpolation.md", {"means": means, "cases": cases})
    with open(options.doc / "interpolation.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(k for r in rows for k in r)), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.4f}" if isinstance(v, float) else v for k, v in row.items()})


if __name__ == "__main__":
    main()
