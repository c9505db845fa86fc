#!/usr/bin/env python3
"""A synthetic capture of the Khronos sample fox by an independent renderer: Blender's Cycles, path traced.

    capture.py Fox.glb CAPTURE/ [--views 48] [--lights 48] [--size 224]

needs Blender's Python module (pip install bpy==5.0.1 'numpy<2', Python 3.11). Each view is rendered under each of the
directional lights alone, the fox in the pose that the file stands in, its normals smoothed, its texture under a satin
coat. Ends with code 77 where the module is missing.
"""
import argparse
import json
import math
import pathlib
import sys

try:
    import bpy
    import bmesh
    import mathutils
except ImportError:
    print("skipped: Blender's Python module is missing (pip install bpy==5.0.1 'numpy<2')")
    sys.exit(77)


def sphere(count, turn=0.0):
    """Directions spread evenly (Fibonacci)."""
    for i in range(count):
        z = 1 - (2 * i + 1) / count
        a = i * math.pi * (3 - math.sqrt(5)) + turn
        r = math.sqrt(1 - z * z)
        yield mathutils.Vector((r * math.cos(a), r * math.sin(a), z))


def fox_at_rest(file):
    """The fox as a mesh of its own, without its skeleton."""
    bpy.ops.import_scene.gltf(filepath=str(file))
    fox = next(o for o in bpy.data.objects if o.type == "MESH" and o.find_armature())
    armature = fox.find_armature()
    armature.animation_data_clear()
    for bone in armature.pose.bones:  # importing leaves the first clip's pose
        bone.matrix_basis.identity()
    bpy.context.view_layer.update()
    evaluated = fox.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = bpy.data.meshes.new_from_object(evaluated)
    mesh.transform(fox.matrix_world)
    for other in list(bpy.data.objects):
        bpy.data.objects.remove(other, do_unlink=True)
    rest = bpy.data.objects.new("fox at rest", mesh)
    bpy.context.collection.objects.link(rest)
    bpy.context.view_layer.objects.active = rest
    rest.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.remove_doubles(threshold=1e-3)
    bpy.ops.mesh.customdata_custom_splitnormals_clear()
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.shade_smooth()
    for material in mesh.materials:
        shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        shader.inputs["Metallic"].default_value = 0
        shader.inputs["Roughness"].default_value = 0.4
    return rest


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=pathlib.Path)
    parser.add_argument("capture", type=pathlib.Path)
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--lights", type=int, default=48)
    parser.add_argument("--size", type=int, default=224)
    options = parser.parse_args()

    bpy.ops.wm.read_factory_settings(use_empty=True)
    rest = fox_at_rest(options.file.resolve())
    corners = [mathutils.Vector(c) for c in rest.bound_box]
    center = sum(corners, mathutils.Vector()) / 8
    radius = max((c - center).length for c in corners)

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 9
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.max_bounces = 0  # direct light and its shadows: no noise
    scene.cycles.filter_width = 1.0
    scene.render.use_persistent_data = True
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = options.size
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.image_settings.color_depth = "16"
    scene.view_settings.view_transform = "Raw"
    world = bpy.data.worlds.new("dark")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    scene.world = world

    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "VERTICAL"
    camera.data.angle_y = math.radians(24)
    camera.data.clip_end = 1e5
    scene.collection.objects.link(camera)
    scene.camera = camera
    distance = 1.02 * radius / math.sin(camera.data.angle_y / 2)

    # A sun of strength 1 puts the irradiance 1 on a plane facing it.
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.angle = 0
    sun.data.energy = 1
    sun.rotation_mode = "QUATERNION"
    scene.collection.objects.link(sun)

    focal = options.size / 2 / math.tan(camera.data.angle_y / 2)
    lights = list(sphere(options.lights, 0.7))
    manifest = {"camera_model": "PINHOLE", "w": options.size, "h": options.size, "fl_x": focal, "fl_y": focal,
                "cx": options.size / 2, "cy": options.size / 2, "color_space": "lin_rec709",
                "lights": [{"name": f"L{k:03}", "type": "directional", "direction": list(d), "irradiance": [1, 1, 1]}
                           for k, d in enumerate(lights)],
                "frames": []}
    folder = options.capture.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for v, toward in enumerate(sphere(options.views)):
        camera.location = center + distance * toward
        camera.rotation_euler = (-toward).to_track_quat("-Z", "Y").to_euler()
        bpy.context.view_layer.update()
        pose = [list(row) for row in camera.matrix_world]
        for k, d in enumerate(lights):
            sun.rotation_quaternion = (-d).to_track_quat("-Z", "Y")
            name = f"images/v{v:03}/L{k:03}.exr"
            scene.render.filepath = str(folder / name)
            bpy.ops.render.render(write_still=True)
            if k == 0:
                write_mask(folder / name, folder / f"masks/v{v:03}.png")
            manifest["frames"].append({"file_path": name, "mask_path": f"masks/v{v:03}.png", "view": f"v{v:03}",
                                       "light": f"L{k:03}", "transform_matrix": pose})
        print(f"view {v + 1} of {options.views}", file=sys.stderr, flush=True)
    write_surface(rest, folder / "surface.ply")
    (folder / "transforms.json").write_text(json.dumps(manifest, indent=1))


def write_surface(rest, file):
    """The fox's surface as a scan would give it: the same facets, in small triangles."""
    work = bmesh.new()
    work.from_mesh(rest.data)
    bmesh.ops.triangulate(work, faces=work.faces)
    bmesh.ops.subdivide_edges(work, edges=work.edges, cuts=7, use_grid_fill=True)
    bmesh.ops.triangulate(work, faces=work.faces)
    work.verts.index_update()
    with open(file, "w", encoding="ascii") as out:
        out.write(f"ply\nformat ascii 1.0\nelement vertex {len(work.verts)}\nproperty float x\nproperty float y\n"
                  f"property float z\nelement face {len(work.faces)}\nproperty list uchar int vertex_indices\nend_header\n")
        for v in work.verts:
            out.write("{:.7g} {:.7g} {:.7g}\n".format(*v.co))
        for f in work.faces:
            out.write("3 {} {} {}\n".format(*(v.index for v in f.verts)))
    work.free()


def write_mask(picture, mask):
    image = bpy.data.images.load(str(picture))
    width, height = image.size
    alpha = list(image.pixels)[3::4]
    bpy.data.images.remove(image)
    out = bpy.data.images.new("mask", width, height)
    out.colorspace_settings.name = "Non-Color"
    out.pixels = [c for a in alpha for c in (a, a, a, 1.0)]
    mask.parent.mkdir(parents=True, exist_ok=True)
    out.file_format = "PNG"
    out.save(filepath=str(mask))
    bpy.data.images.remove(out)


main()
