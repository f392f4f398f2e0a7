"""Skinned meshes (glTF 2.0, .glb or .gltf) as bodies: the vertices of each joint become a limb."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from voodoo_jax.config.limited import too_large
from voodoo_jax.geometry.arrays_file import array_at
from voodoo_jax.model.checked_toml import BodyFileError
from voodoo_jax.model.foreign.assembly import Piece, assembled
from voodoo_jax.storage.troubles import small_file

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942  # glTF 2.0 specification, sec. 4
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # the same, sec. 3.6.2.2
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
UPRIGHT = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # glTF: y up, z forwards, x to the left; here z up, x forwards
SAMPLES = 2000  # points on each limb
FEW = 8  # triangles: fewer make no limb


def read_skinned(path: Path, rest: dict[str, float], least: float) -> tuple[str, list[str]]:
    """The text of a body file: see sources.body_from. All joints turn freely: a mesh does not say about which axes."""
    try:
        file = _File(path)
        return _body_of(file, path, least)
    except BodyFileError:
        raise
    except (OSError, ValueError, KeyError, IndexError, TypeError, struct.error) as problem:
        raise BodyFileError(
            str(path), None, f"it cannot be read as glTF: {type(problem).__name__}: {problem}"
        ) from problem


class _File:
    """The JSON of a glTF file, and its arrays."""

    def __init__(self, path: Path):
        data, self.folder, self.binary = small_file(path), path.resolve().parent, b""
        self.tree: dict[str, Any] = {}
        if data[:4] == struct.pack("<I", MAGIC):
            at = 12
            while at + 8 <= len(data):
                length, kind = struct.unpack("<II", data[at : at + 8])
                part = data[at + 8 : at + 8 + length]
                if kind == JSON_CHUNK:
                    self.tree = json.loads(part)
                elif kind == BINARY_CHUNK:
                    self.binary = part
                at += 8 + length
        else:
            self.tree = json.loads(data)
        self.buffers = [self._buffer(buffer) for buffer in self.tree.get("buffers", [])]

    def _buffer(self, buffer: dict[str, Any]) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            return self.binary
        return (
            base64.b64decode(uri.split(",", 1)[1])
            if uri.startswith("data:")
            else small_file(self.folder / uri, self.folder)
        )

    def array(self, number: int) -> np.ndarray:
        """An accessor's values [row, component]; normalised integers as numbers from 0 to 1."""
        accessor = self.tree["accessors"][number]
        kind, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("sparse arrays are not read")
        view = self.tree["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        step = view.get("byteStride", kind.itemsize * width)
        if trouble := too_large(f"array {number} has", accessor["count"], "points", "rows"):
            raise ValueError(trouble)
        shape = accessor["count"], width
        found = np.ascontiguousarray(array_at(self.buffers[view["buffer"]], kind, shape, start, (step, kind.itemsize)))
        return found / np.iinfo(kind).max if accessor.get("normalized") else found

    def places(self) -> np.ndarray:
        """T_scene_node of all nodes as they stand [node, 4, 4]."""
        nodes = self.tree["nodes"]
        over = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}
        out: dict[int, np.ndarray] = {}

        def place(i: int) -> np.ndarray:
            if i not in out:
                out[i] = place(over[i]) @ _local(nodes[i]) if i in over else _local(nodes[i])
            return out[i]

        return np.array([place(i) for i in range(len(nodes))])


def _local(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    out = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
    out[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), float)
    out[:3, 3] = node.get("translation", [0, 0, 0])
    return out


def _body_of(file: _File, path: Path, least: float) -> tuple[str, list[str]]:
    nodes = file.tree.get("nodes", [])
    skinned = [node for node in nodes if "skin" in node and "mesh" in node]
    if not skinned:
        raise BodyFileError(str(path), None, "it has no mesh with a skin (joints that move its vertices)")
    places = file.places()
    skin = file.tree["skins"][skinned[0]["skin"]]
    joints = skin["joints"]
    same = [node for node in skinned if file.tree["skins"][node["skin"]]["joints"] == joints]
    surfaces = _surfaces(file, same, joints, places)
    over = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}
    notes = [f"{len(skinned) - len(same)} meshes of other skeletons were left out"] if len(same) < len(skinned) else []
    pieces = _pieces(joints, over, nodes, places, surfaces, least, notes)
    body, more = assembled(pieces, path.stem, "reach", str(path))
    return body, notes + more


def _surfaces(
    file: _File, skinned: list[dict[str, Any]], joints: list[int], places: np.ndarray
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Points on the triangles of each joint and their normals, upright, metres, as the skeleton stands."""
    parts: dict[int, list[trimesh.Trimesh]] = {joint: [] for joint in joints}
    for node in skinned:
        skin = file.tree["skins"][node["skin"]]
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        if "inverseBindMatrices" in skin:
            inverse = file.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1).astype(float)
        moved = places[joints] @ inverse
        for primitive in file.tree["meshes"][node["mesh"]]["primitives"]:
            at = primitive["attributes"]
            if primitive.get("mode", 4) != 4 or not {"JOINTS_0", "WEIGHTS_0"} <= set(at):
                continue
            vertices = file.array(at["POSITION"]).astype(float)
            vertices = np.c_[vertices, np.ones(len(vertices))]
            rows, weights = file.array(at["JOINTS_0"]).astype(int), file.array(at["WEIGHTS_0"]).astype(float)
            weights = weights / np.maximum(weights.sum(1, keepdims=True), 1e-9)
            world = np.einsum("vk,vkij,vj->vi", weights, moved[rows], vertices)[:, :3] @ UPRIGHT.T
            faces = file.array(primitive["indices"]).reshape(-1, 3) if "indices" in primitive else None
            faces = np.arange(len(world) // 3 * 3).reshape(-1, 3) if faces is None else faces.astype(int)
            owner = rows[np.arange(len(rows)), weights.argmax(1)]
            # a triangle is of the joint that most of its corners follow
            corners = np.sort(owner[faces], axis=1)[:, 1]
            for row in np.unique(corners):
                parts[joints[row]].append(trimesh.Trimesh(world, faces[corners == row], process=False))
    return {joint: _sampled(meshes) for joint, meshes in parts.items()}


def _sampled(meshes: list[trimesh.Trimesh]) -> tuple[np.ndarray, np.ndarray]:
    if sum(len(mesh.faces) for mesh in meshes) < FEW:
        return np.zeros((0, 3)), np.zeros((0, 3))
    whole = trimesh.util.concatenate(meshes)
    points, faces = trimesh.sample.sample_surface(whole, SAMPLES, seed=0)[:2]
    return np.asarray(points, float), np.asarray(whole.face_normals[faces], float)  # type: ignore[attr-defined]


# 7 parameters: the skeleton, its surfaces, and what is too small
def _pieces(
    joints: list[int],
    over: dict[int, int],
    nodes: list[dict[str, Any]],
    places: np.ndarray,
    surfaces: dict[int, tuple[np.ndarray, np.ndarray]],
    least: float,
    notes: list[str],
) -> list[Piece]:
    """Limbs in the order of the tree; joints with a small part are merged with their parent."""
    pieces: list[Piece] = []
    owner: dict[int, int] = {}
    depth = lambda j: 1 + depth(over[j]) if j in over else 0  # noqa: E731
    used: set[str] = set()
    for joint in sorted(joints, key=depth):
        above = over.get(joint)
        while above is not None and above not in owner:
            above = over.get(above)
        points, normals = surfaces[joint]
        size = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
        name = str(nodes[joint].get("name", f"joint{joint}"))
        name = name.rsplit(":", 1)[-1]  # of Mixamo's prefix
        name = name if name not in used else f"{name}_{joint}"
        used.add(name)
        if above is None and pieces:  # another tree of joints
            above = next(iter(owner))
        if size >= least:
            number = owner[above] if above is not None else -1
            pieces.append(Piece(name, number, points, normals, name, UPRIGHT @ places[joint][:3, 3]))
            owner[joint] = len(pieces) - 1
        elif above is not None:
            owner[joint] = owner[above]
            if len(points):
                old = pieces[owner[above]]
                pieces[owner[above]] = old.with_surface(points, normals)
                notes.append(f"'{name}' is small: merged with '{old.name}'")
    if not pieces:
        raise ValueError("no joint moves a large enough part of the mesh")
    return pieces
