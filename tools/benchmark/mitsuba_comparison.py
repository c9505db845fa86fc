#!/usr/bin/env python3
"""Times Mitsuba 3's fastest CPU variant on a frame of the benchmark: the same deformed object with its true kind of
material (a textured rough plastic, alpha 0.15) under the same environment, by samples per pixel, each with its error
against its own converged picture; and tells how long it takes to reach given errors.

Needs the packages mitsuba and numpy (and libLLVM) in a virtual environment of its own:
    python3 -m venv venv && venv/bin/pip install mitsuba numpy
    build/release/apps/srf model X.srf --export object.ply
    venv/bin/python tools/benchmark/mitsuba_comparison.py tools/benchmark/twist.json object.ply --frame 5 --db 28 35 40
"""

import argparse
import json
import math
import pathlib
import time


def key_value(animated, frame):
    """A number or {"keys": [[frame, value], ..]}, linear between keys."""
    if not isinstance(animated, dict):
        return animated
    keys = animated["keys"]
    for (f0, v0), (f1, v1) in zip(keys, keys[1:]):
        if f0 <= frame <= f1:
            return v0 + (v1 - v0) * (frame - f0) / (f1 - f0)
    return keys[-1][1] if frame > keys[-1][0] else keys[0][1]


def texture(np, p):
    """The synthetic capture's albedo (acquire/synthetic_material.cpp) at points [n, 3]."""
    x, y, z = p.T
    s = np.sin(5.5 * x + 0.8) * np.sin(5.5 * y + 1.9) * np.sin(5.5 * z + 0.5)
    check = (0.5 + 0.5 * s / np.sqrt(s * s + 0.03))[:, None]
    w1, w2 = 0.5 + 0.5 * np.sin(3.1 * x + 2.3 * z), 0.5 + 0.5 * np.sin(4.2 * y - 1.7 * x + 1)
    w3 = 0.5 + 0.5 * np.sin(3.7 * z + 2.9 * y + 2)
    warm = np.stack([np.full_like(x, 0.80), 0.34 + 0.30 * w1, 0.12 + 0.14 * w2], axis=1)
    cold = np.stack([0.06 + 0.16 * w3, 0.22 + 0.20 * w2, 0.45 + 0.30 * w1], axis=1)
    return check * warm + (1 - check) * cold


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=pathlib.Path, help="scene.json with a twist about z and an environment")
    parser.add_argument("mesh", type=pathlib.Path, help="the object at rest, PLY")
    parser.add_argument("--frame", type=float, default=5)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--db", type=float, nargs="+", default=[35, 40], help="errors to reach")
    parser.add_argument("--most", type=int, default=256, help="samples per pixel timed")
    parser.add_argument("--converged", type=int, default=1024, help="samples per pixel of the reference")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    options = parser.parse_args()

    import mitsuba as mi
    mi.set_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Error)  # its warnings would stand in the page
    import drjit as dr
    import numpy as np

    scene_json = json.loads(options.scene.read_text())
    camera = scene_json["camera"]
    look = camera["look_at"]
    environment = scene_json["lights"][0]
    twist = math.radians(key_value(scene_json["deformation"][0]["degrees_per_unit"], options.frame))

    mesh = mi.load_dict({"type": "ply", "filename": str(options.mesh), "face_normals": False})
    parameters = mi.traverse(mesh)
    rest = np.array(parameters["vertex_positions"]).reshape(-1, 3)
    angle = twist * rest[:, 2]
    moved = np.stack([np.cos(angle) * rest[:, 0] - np.sin(angle) * rest[:, 1],
                      np.sin(angle) * rest[:, 0] + np.cos(angle) * rest[:, 1], rest[:, 2]], axis=1)
    color = texture(np, rest)

    # roughplastic takes no colours of vertices; this one has the same matt base under a GGX coat of alpha 0.15.
    bsdf = {"type": "principled", "roughness": math.sqrt(0.15), "specular": 0.5,
            "base_color": {"type": "mesh_attribute", "name": "vertex_color"}}
    faces = np.array(parameters["faces"]).reshape(-1, 3)
    deformed = mi.Mesh("deformed", len(moved), len(faces), has_vertex_normals=True,
                       props=_properties(mi, bsdf))
    deformed.add_attribute("vertex_color", 3, color.astype(np.float32).ravel())
    to = mi.traverse(deformed)
    to["vertex_positions"] = moved.astype(np.float32).ravel()
    to["faces"] = faces.astype(np.uint32).ravel()
    to.update()

    transform = mi.ScalarTransform4f
    scene = mi.load_dict({
        "type": "scene",
        # One bounce, light and surface sampled together: the cheapest integrator that is exact here.
        "integrator": {"type": "direct"},
        "sensor": {
            "type": "perspective", "fov": camera["vfov"], "fov_axis": "y",
            "to_world": transform().look_at(origin=look["eye"], target=look["target"], up=look["up"]),
            "film": {"type": "hdrfilm", "width": options.size, "height": options.size, "rfilter": {"type": "box"}},
        },
        "environment": {
            "type": "envmap", "filename": str((options.scene.parent / environment["map"]).resolve()),
            "to_world": transform().rotate([0, 0, 1], key_value(environment["rotation"], options.frame))
            .rotate([1, 0, 0], 90),
        },
        "object": deformed,
    })

    def render(samples, seed):
        start = time.perf_counter()
        image = mi.render(scene, spp=samples, seed=seed)
        dr.eval(image)
        dr.sync_thread()
        return np.array(image), time.perf_counter() - start

    parts = max(1, options.converged // 64)
    converged = sum(render(64, 1000 + i)[0].astype(np.float64) for i in range(parts)) / parts
    peak = np.percentile(converged, 99.9)
    inside = mi.render(mi.load_dict({"type": "scene", "integrator": {"type": "depth"},
                                     "sensor": scene.sensors()[0], "object": deformed}), spp=1)
    inside = np.array(inside)[:, :, 0] > 0

    print("| samples per pixel | ms (best of 3) | dB within the object |\n|---|---|---|")
    rows = []
    samples = 1
    while samples <= options.most:
        render(samples, 1)  # compiles
        timed = [render(samples, 2 + i) for i in range(3)]
        seconds = min(t for _, t in timed)
        measured = np.mean((timed[0][0] - converged)[inside] ** 2)
        error = measured / (1 + samples / (64 * parts))  # less the reference's own noise
        rows.append((samples, seconds, 10 * math.log10(peak ** 2 / error)))
        print(f"| {samples} | {1e3 * seconds:.0f} | {rows[-1][2]:.1f} |", flush=True)
        samples *= 2

    for wanted in options.db:
        # The error falls with the samples, by 3 dB a doubling; time grows with them.
        samples, seconds, db = min(rows, key=lambda row: abs(row[2] - wanted))
        needed = samples * 10 ** ((wanted - db) / 10)
        per_sample = (rows[-1][1] - rows[0][1]) / (rows[-1][0] - rows[0][0])
        print(f"\n{wanted:g} dB: {needed:.1f} samples per pixel, {1e3 * (seconds + (needed - samples) * per_sample):.0f} ms")


def _properties(mi, bsdf):
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    return properties


if __name__ == "__main__":
    main()
