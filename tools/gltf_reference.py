#!/usr/bin/env python3
"""Where animated glTF files put their vertices, computed a second way: numpy for the blending, scipy for the rotations
and splines. The table that tests/model/gltf_reference.csv holds was made by

    tools/gltf_reference.py --vertices 12 DATA/animated/{SimpleSkin.gltf,RiggedSimple.glb,...} > tests/model/gltf_reference.csv

Every animation, 20 times from before its first key to after its last; positions with +z up, as srf has them.
--vertices 0 writes all of them: SRF_GLTF_REFERENCE=that table makes the test compare them all.
"""
import argparse
import base64
import json
import pathlib
import struct

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class File:
    def __init__(self, path):
        data, chunk = path.read_bytes(), None
        if data[:4] == b"glTF":
            size = struct.unpack_from("<I", data, 12)[0]
            self.json = json.loads(data[20:20 + size])
            chunk = data[28 + size:]
        else:
            self.json = json.loads(data)
        self.buffers = []
        for buffer in self.json["buffers"]:
            uri = buffer.get("uri")
            self.buffers.append(chunk if uri is None else base64.b64decode(uri.split(",", 1)[1])
                                if uri.startswith("data:") else (path.parent / uri).read_bytes())

    def raw(self, holder, dtype, width, count):
        view = self.json["bufferViews"][holder["bufferView"]]
        start = view.get("byteOffset", 0) + holder.get("byteOffset", 0)
        size = np.dtype(dtype).itemsize * width
        stride = view.get("byteStride", size)
        rows = [np.frombuffer(self.buffers[view["buffer"]], dtype, width, start + i * stride) for i in range(count)]
        return np.array(rows, dtype).reshape(count, width)

    def accessor(self, index):
        a = self.json["accessors"][index]
        dtype, width = TYPES[a["componentType"]], WIDTH[a["type"]]
        values = self.raw(a, dtype, width, a["count"]) if "bufferView" in a else np.zeros((a["count"], width), dtype)
        if "sparse" in a:
            s = a["sparse"]
            where = self.raw(s["indices"], TYPES[s["indices"]["componentType"]], 1, s["count"])[:, 0]
            values[where] = self.raw(s["values"], dtype, width, s["count"])
        values = values.astype(float)
        return values / np.iinfo(dtype).max if a.get("normalized") else values


def sample(times, values, way, t, rotation):
    if way == "CUBICSPLINE":
        values = values.reshape(len(times), 3, -1)
        t = np.clip(t, times[0], times[-1])
        # The slopes on either side of a key differ, so each piece is a spline of its own.
        k = min(np.searchsorted(times, t, "right") - 1, len(times) - 2) if len(times) > 1 else 0
        value = values[0, 1] if len(times) == 1 else CubicHermiteSpline(
            times[k:k + 2], values[k:k + 2, 1], np.array([values[k, 2], values[k + 1, 0]]))(t)
        return value / np.linalg.norm(value) if rotation else value
    values = values.reshape(len(times), -1)
    if t <= times[0] or len(times) == 1:
        return values[0]
    if t >= times[-1]:
        return values[-1]
    k = np.searchsorted(times, t, "right") - 1
    if way == "STEP":
        return values[k]
    if rotation:
        return Slerp(times[k:k + 2], Rotation.from_quat(values[k:k + 2]))(t).as_quat()
    return np.array([np.interp(t, times[k:k + 2], column) for column in values[k:k + 2].T])


def posed(file, animation, t):
    j = file.json
    nodes = [dict(n) for n in j["nodes"]]
    for channel in animation["channels"] if animation else []:
        s, target = animation["samplers"][channel["sampler"]], channel["target"]
        nodes[target["node"]][target["path"]] = sample(
            file.accessor(s["input"])[:, 0], file.accessor(s["output"]), s.get("interpolation", "LINEAR"), t,
            target["path"] == "rotation")

    def local(n):
        if "matrix" in n:
            return np.array(n["matrix"], float).reshape(4, 4).T
        m = np.eye(4)
        m[:3, :3] = Rotation.from_quat(n.get("rotation", [0, 0, 0, 1])).as_matrix() @ np.diag(n.get("scale", [1, 1, 1]))
        m[:3, 3] = n.get("translation", [0, 0, 0])
        return m

    parent = {c: i for i, n in enumerate(nodes) for c in n.get("children", [])}

    def world(i):
        return (world(parent[i]) if i in parent else np.eye(4)) @ local(nodes[i])

    index, node = next((i, n) for i, n in enumerate(nodes) if "mesh" in n)
    mesh = j["meshes"][node["mesh"]]
    parts = []
    for primitive in mesh["primitives"]:
        attributes = primitive["attributes"]
        p = file.accessor(attributes["POSITION"])
        weights = node.get("weights", mesh.get("weights", []))
        for w, target in zip(weights, primitive.get("targets", [])):
            if "POSITION" in target:
                p = p + w * file.accessor(target["POSITION"])
        p = np.hstack([p, np.ones((len(p), 1))])
        if "skin" in node:
            skin = j["skins"][node["skin"]]
            bind = file.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            joints = np.array([world(k) @ b for k, b in zip(skin["joints"], bind)])
            w = file.accessor(attributes["WEIGHTS_0"])
            w /= w.sum(1, keepdims=True)
            matrices = np.einsum("vk,vkij->vij", w, joints[file.accessor(attributes["JOINTS_0"]).astype(int)])
            parts.append(np.einsum("vij,vj->vi", matrices, p)[:, :3])
        else:
            parts.append((p @ world(index).T)[:, :3])
    x, y, z = np.vstack(parts).T
    return np.stack([x, -z, y], 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=pathlib.Path)
    parser.add_argument("--vertices", type=int, default=12, help="spread over the mesh; 0: all")
    parser.add_argument("--at-keys", action="store_true", help="at 20 of the keys instead: for tools/blender/sample_assets.py")
    options = parser.parse_args()
    print("# Positions of vertices of the Khronos glTF sample assets, computed by tools/gltf_reference.py.")
    print("# Fox: PixelMannen (CC0), rig tomkranis (CC-BY 4.0). CesiumMan, RiggedSimple: Cesium (CC-BY 4.0).")
    print("# MorphStressTest: Analytical Graphics (CC-BY 4.0). SimpleSkin: Marco Hutter (CC0).")
    print("file,animation,seconds,vertex,x,y,z")
    for path in options.files:
        file = File(path)
        for animation in file.json["animations"]:
            keys = np.concatenate([file.accessor(s["input"])[:, 0] for s in animation["samplers"]])
            span = keys.max() - keys.min()
            times = np.linspace(keys.min() - 0.02 * span, keys.max() + 0.02 * span, 20)
            if options.at_keys:
                keys = np.unique(keys)
                times = keys[np.unique(np.linspace(0, len(keys) - 1, 20).astype(int))]
            for t in times:
                t = float(np.float32(t))
                p = posed(file, animation, t)
                count = len(p) if options.vertices == 0 else min(options.vertices, len(p))
                for v in np.unique(np.linspace(0, len(p) - 1, count).astype(int)):
                    print(f"{path.name},{animation.get('name', '')},{t:.9g},{v}," + ",".join(f"{c:.8g}" for c in p[v]))


if __name__ == "__main__":
    main()
