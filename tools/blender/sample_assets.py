"""Blender's own reading of animated glTF files, held against the table of tools/gltf_reference.py:

    tools/gltf_reference.py --vertices 0 --at-keys DATA/animated/*.gl* > keys.csv
    python tools/blender/sample_assets.py keys.csv DATA/animated        # with bpy==5.0.1 and 'numpy<2'

At keys alone: between them Blender mixes the numbers of a quaternion where glTF turns at even speed.
"""
import collections
import pathlib
import sys

try:
    import bpy
    import numpy as np
except ImportError:
    print("skipped: Blender's Python module is missing (pip install bpy==5.0.1 'numpy<2')")
    sys.exit(77)

FPS = 24


def positions(body):
    seen = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
    flat = np.zeros(3 * len(seen.data.vertices), np.float32)
    seen.data.vertices.foreach_get("co", flat)
    matrix = np.array(seen.matrix_world)
    return flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def play(holder, clip):
    """The imported clip as the action of its own: as a strip it would begin at a whole frame."""
    data = holder.animation_data
    for track in data.nla_tracks:
        track.mute = True
        if not clip or track.name == clip or track.strips[0].action.name.startswith(clip):
            data.action = track.strips[0].action
            data.action_slot = track.strips[0].action_slot


def main():
    table = collections.defaultdict(lambda: collections.defaultdict(list))
    for line in open(sys.argv[1], encoding="utf-8"):
        if not line.startswith(("#", "file,")):
            name, clip, seconds, _, *place = line.rstrip().split(",")
            table[name, clip][float(seconds)].append([float(c) for c in place])
    worst = 0.0
    for (name, clip), times in table.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.scene.render.fps = FPS
        bpy.ops.import_scene.gltf(filepath=str(pathlib.Path(sys.argv[2]) / name))
        body = next(o for o in bpy.data.objects if o.type == "MESH" and (o.find_armature() or o.data.shape_keys))
        for holder in (body.find_armature(), body.data.shape_keys, body):
            if holder is not None and holder.animation_data:
                play(holder, clip)
        off = size = 0.0
        for seconds, expected in times.items():
            frame, expected = seconds * FPS, np.array(expected)
            bpy.context.scene.frame_set(int(frame), subframe=frame - int(frame))
            size = max(size, np.linalg.norm(np.ptp(expected, axis=0)))
            off = max(off, np.abs(positions(body) - expected).max())
        print(f"{name} {clip}: {len(times)} times, at most {off / size:.2g} of the size off", flush=True)
        worst = max(worst, off / size)
    sys.exit(0 if worst < 1e-5 else "Blender puts vertices elsewhere")


main()
