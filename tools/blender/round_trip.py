"""The way through Blender, checked: rest mesh out, rigged and animated, GLB back, rendered.

    python round_trip.py [--vertices 50000]               with Blender's Python module (pip install bpy==5.0.1 'numpy<2')
    blender -b --python round_trip.py -- [--vertices N]   with an installed Blender

SRF_BUILD names the build folder (build/release). A torus is exported, bent by two bones and a shape key in Blender with
flat shading (which splits every vertex), and comes back as a skin. The same frames are also written as meshes, straight
from Blender's own evaluation: both scenes must give the same picture. Says 'skipped' and ends with code 77 where Blender
is missing.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

try:
    import bpy
    import numpy as np
except ImportError:
    print("skipped: no Blender here (pip install bpy==5.0.1 'numpy<2', or blender -b --python round_trip.py)")
    sys.exit(77)

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import srf_blender  # noqa: E402

BUILD = pathlib.Path(os.environ.get("SRF_BUILD", HERE.parent.parent / "build/release")).resolve()
FRAMES = (0, 7, 24)


def srf(*arguments):
    run = subprocess.run([BUILD / "apps/srf", *map(str, arguments)], capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"srf {' '.join(map(str, arguments))}\nended with {run.returncode}: {run.stderr}")
    return run.stdout + run.stderr


def write_ply(file, positions, triangles):
    faces = np.zeros(len(triangles), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, triangles
    head = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(positions)}\nproperty double x\nproperty double y\n"
            f"property double z\nelement face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n")
    file.write_bytes(head.encode() + np.asarray(positions, "<f8").tobytes() + faces.tobytes())


def torus(count):
    across = int(np.sqrt(count / 2))
    around = -(-count // across)
    a, b = np.meshgrid(2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across, indexing="ij")
    r = 0.68 + 0.28 * np.cos(b)
    points = np.stack([r * np.cos(a), r * np.sin(a), 0.28 * np.sin(b)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    at = lambda p, q: (p % around) * across + q % across  # noqa: E731
    quads = np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], -1).reshape(-1, 4)
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def values(collection, name, width, dtype=np.float32):
    flat = np.zeros(len(collection) * width, dtype)
    collection.foreach_get(name, flat)
    return flat.reshape(-1, width)


def rig(body):
    """Two bones along x with smooth weights, a shape key, keys on all, a camera and a lamp that move."""
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.frame_start, scene.frame_end = 0, 24
    body.data.polygons.foreach_set("use_smooth", [False] * len(body.data.polygons))
    armature = bpy.data.objects.new("bones", bpy.data.armatures.new("bones"))
    scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for name, head, tail in (("low", (-1, 0, 0), (0, 0, 0)), ("high", (0, 0, 0), (1, 0, 0))):
        bone = armature.data.edit_bones.new(name)
        bone.head, bone.tail = head, tail
    armature.data.edit_bones["high"].parent = armature.data.edit_bones["low"]
    bpy.ops.object.mode_set(mode="OBJECT")
    x = values(body.data.vertices, "co", 3)[:, 0]
    for name, weight in (("low", np.clip(0.5 - x, 0, 1)), ("high", np.clip(0.5 + x, 0, 1))):
        group = body.vertex_groups.new(name=name)
        for i, w in enumerate(weight):
            if w > 0:
                group.add([i], float(w), "REPLACE")
    body.parent = armature
    body.modifiers.new("bones", "ARMATURE").object = armature
    bone = armature.pose.bones["high"]
    bone.rotation_mode = "XYZ"
    for frame, angle in ((0, 0.0), (12, 0.4), (24, 1.0)):
        bone.rotation_euler = (0.3 * angle, angle, 0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    body.shape_key_add(name="Basis")
    key = body.shape_key_add(name="swell")
    rest = values(body.data.vertices, "co", 3)
    key.data.foreach_set("co", (rest * (1 + 0.2 * np.sin(3 * rest[:, 1:2]))).ravel())
    for frame, value in ((0, 0.0), (24, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    camera.data.sensor_fit = "VERTICAL"
    camera.data.angle_y = 0.6
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    for o in (camera, lamp):
        scene.collection.objects.link(o)
    camera.rotation_euler = (1.2, 0, 0)
    for frame, place in ((0, (0, -4, 1.6)), (24, (0.4, -4, 1.6))):
        camera.location = place
        camera.keyframe_insert("location", frame=frame)
    lamp.location = (2, -3, 3)
    return camera


def evaluated(body, frame):
    bpy.context.scene.frame_set(frame)
    seen = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
    matrix = np.array(seen.matrix_world)
    return values(seen.data.vertices, "co", 3) @ matrix[:3, :3].T + matrix[:3, 3]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vertices", type=int, default=50000)
    own = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else [] if bpy.app.binary_path else sys.argv[1:]
    options = parser.parse_args(own)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        srf("synth", "-o", folder / "ring", "--object", "torus", "--views", 12, "--lights", 6, "--size", 64)
        srf("acquire", folder / "ring", "-o", folder / "ring.srf")
        points, triangles = torus(options.vertices)
        write_ply(folder / "torus.ply", points, triangles)
        srf("model", folder / "ring.srf", "--shape", folder / "torus.ply", "--fit", "off", "--export", folder / "rest.glb")
        srf("model", folder / "ring.srf", "--export", folder / "rest.ply")

        if hasattr(bpy.ops.wm, "read_factory_settings"):
            bpy.ops.wm.read_factory_settings(use_empty=True)
        try:
            bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
        except RuntimeError:
            pass  # built in already
        body = srf_blender.import_rest(folder / "rest.glb")
        count = len(body.data.vertices)
        index = values(body.data.attributes[srf_blender.INDEX].data, "value", 1)[:, 0].astype(int)
        if count != len(points) or sorted(index) != list(range(count)):
            sys.exit(f"the rest mesh came with {count} of {len(points)} vertices, or not all of their numbers")
        order = np.argsort(index)
        corners = values(body.data.loops, "vertex_index", 1, np.int32)[:, 0].reshape(-1, 3)
        off = np.abs(values(body.data.vertices, "co", 3)[order] - points).max()
        print(f"Blender {bpy.app.version_string}: {count} vertices imported, {off:.2g} off")
        camera = rig(body)
        for frame in FRAMES:
            write_ply(folder / f"walk.{frame:04}.ply", evaluated(body, frame)[order], index[corners])
        srf_blender.export_skin(folder / "posed.glb", body)
        body.data.attributes.remove(body.data.attributes[srf_blender.INDEX])
        srf_blender.export_skin(folder / "by_uv.glb", body)

        light = {"type": "gltf", "file": "posed.glb", "name": "lamp", "scale": 0.02}
        look = {"w": 160, "h": 120, "gltf": {"file": "posed.glb", "name": "eye"}}
        frames = ",".join(map(str, FRAMES))
        pictures = {}
        for way, step in (("skin", {"type": "skin", "file": "posed.glb", "mesh": body.data.name}),
                          ("uv", {"type": "skin", "file": "by_uv.glb", "mesh": body.data.name}),
                          ("mesh", {"type": "sequence", "file": "walk.####.ply"})):
            scene = {"srf": "ring.srf", "camera": look, "deformation": [step], "fps": 24, "frames": frames,
                     "lights": [light, {"type": "directional", "direction": [0.3, -1, 1], "irradiance": [3, 3, 3]}]}
            (folder / f"{way}.json").write_text(json.dumps(scene))
            said = srf("render", folder / f"{way}.json", "-o", folder / f"{way}.####.exr", "--aovs", "P",
                       "--log-level", "info")
            print(*(line.split("srf")[-1] for line in said.splitlines() if " found among " in line), sep="\n")
            pictures[way] = [folder / f"{way}.{f:04}.exr" for f in FRAMES]
        least = np.inf
        for way in ("skin", "uv"):
            for mine, meant in zip(pictures[way], pictures["mesh"]):
                psnr = json.loads(srf("compare", mine, meant, "--json"))["full_psnr"]
                least = min(least, np.inf if psnr is None else psnr)
        print(f"least PSNR against Blender's own evaluation: {least:.1f} dB")
        moved = [camera.matrix_world.translation.x for f in FRAMES if bpy.context.scene.frame_set(f) is None]
        print(f"the camera went from x = {moved[0]:.3f} to {moved[-1]:.3f}")
        # Floats of another order, and pixels on the rim that they tip over.
        if least < 55:
            sys.exit("the pictures differ")
        print("passed")


main()
