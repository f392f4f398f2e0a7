"""glTF 2.0, binary (.glb) or one file of text (.gltf): the limbs as a skinned mesh on bones, with one animation.

Metres, y up, z forwards, as the format demands. Times are those of the frames. Frames without pose repeat the last one;
`extras` of the animation says which these are.
"""

import base64
import json
import os
import struct
from pathlib import Path

import numpy as np

from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.frames import ANIMATION, seconds
from voodoo_jax.exporters.skeleton import SIDE_COLOURS, Skeleton, limb_meshes, skeleton
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing

FLOAT, UINT, BYTE = 5126, 5125, 5121  # component types of the format
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def write(tracks: Tracks, path: str | os.PathLike[str], style: Style | None = None) -> None:
    """Writes a binary file, or text if the name ends in .gltf. Raises OSError."""
    document, data = _document(tracks, style)
    if Path(path).suffix.lower() == ".gltf":
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        written = json.dumps(document, allow_nan=False).encode()
    else:
        text = json.dumps(document, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        data += b"\0" * (-len(data) % 4)
        header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(data))
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        written = header + chunks
    with replacing(path) as partial:
        partial.write_bytes(written)


class _Buffer:
    """The buffer of a file, and the accessors into it."""

    def __init__(self) -> None:
        self.data, self.views, self.accessors = bytearray(), [], []

    def add(self, values: np.ndarray, bounds: bool = False) -> int:
        """Appends an array [element, component] and returns its accessor."""
        values = np.ascontiguousarray(values)
        kind = {np.dtype("float32"): FLOAT, np.dtype("uint32"): UINT, np.dtype("uint8"): BYTE}[values.dtype]
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        width = int(np.prod(values.shape[1:], dtype=int))
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": kind,
            "count": len(values),
            "type": KINDS[width],
        }
        if bounds:
            flat = values.reshape(len(values), -1)
            accessor |= {"min": flat.min(0).tolist(), "max": flat.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _document(tracks: Tracks, style: Style | None) -> tuple[dict, bytes]:
    bones, buffer = skeleton(tracks, ANIMATION, style), _Buffer()
    count, f32 = len(bones.names), np.float32
    nodes: list[dict] = []
    for i, name in enumerate(bones.names):
        node: dict = {"name": name, "translation": bones.offsets[i].astype(f32).tolist(), "rotation": [0, 0, 0, 1]}
        if children := bones.children(i):
            node["children"] = children
        nodes.append(node)
    nodes.append({"name": "limbs", "mesh": 0, "skin": 0})
    binds = np.tile(np.eye(4), (count, 1, 1))
    binds[:, :3, 3] = -bones.bind
    skin = {
        "name": tracks.body.name,
        "joints": list(range(count)),
        "skeleton": 0,
        "inverseBindMatrices": buffer.add(binds.transpose(0, 2, 1).reshape(count, 16).astype(f32)),  # column by column
    }
    primitives, materials = _primitives(tracks, bones, buffer)
    extras = {"units": "metres", "axes": "y up, z forwards", "source": Path(tracks.source).name}
    document = {
        "asset": {"version": "2.0", "generator": "voodoo_jax", "extras": extras},
        "scene": 0,
        "scenes": [{"name": Path(tracks.source).stem, "nodes": [0, count]}],
        "nodes": nodes,
        "skins": [skin],
        "meshes": [{"name": "limbs", "primitives": primitives}],
        "materials": materials,
    }
    if len(tracks.time_ns):
        document["animations"] = [_animation(tracks, bones, buffer)]
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    return document, bytes(buffer.data)


def _primitives(tracks: Tracks, bones: Skeleton, buffer: _Buffer) -> tuple[list[dict], list[dict]]:
    primitives, materials = [], []
    for mesh in limb_meshes(tracks.body, bones):
        joints, weights = np.zeros((len(mesh.vertices), 4), np.uint8), np.zeros((len(mesh.vertices), 4), np.float32)
        joints[:, 0], weights[:, 0] = mesh.bones, 1
        attributes = {
            "POSITION": buffer.add(mesh.vertices.astype(np.float32), bounds=True),
            "NORMAL": buffer.add(mesh.normals.astype(np.float32)),
            "JOINTS_0": buffer.add(joints),
            "WEIGHTS_0": buffer.add(weights),
        }
        indices = buffer.add(mesh.faces.reshape(-1, 1).astype(np.uint32))
        primitives.append({"attributes": attributes, "indices": indices, "material": len(materials)})
        colour = {"baseColorFactor": [*SIDE_COLOURS[mesh.side], 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
        materials.append({"name": mesh.side, "pbrMetallicRoughness": colour})
    return primitives, materials


def _animation(tracks: Tracks, bones: Skeleton, buffer: _Buffer) -> dict:
    time = buffer.add(seconds(tracks).astype(np.float32)[:, None], bounds=True)
    samplers, channels = [], []
    for i in range(len(bones.names)):
        xyzw = np.roll(bones.rotation[:, i], -1, 1).astype(np.float32)
        for path, values in (("rotation", xyzw), ("translation", bones.translation[:, i].astype(np.float32))):
            samplers.append({"input": time, "output": buffer.add(values), "interpolation": "LINEAR"})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": i, "path": path}})
    held = {"frames_without_pose": np.flatnonzero(bones.held).tolist(), "they": "repeat the last pose"}
    return {"name": "tracks", "samplers": samplers, "channels": channels, "extras": held}
