"""Body files: a body as TOML that people can read and edit.

Positions are in the body frame of the rest pose (z up, x forward, y left, origin on the floor), every length is a
multiple of the key `scale`. A file that does not describe a body is refused with its name, the line and the reason.
"""

import json
import os
from collections.abc import Iterable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from voodoo_jax.config.limited import SIZES, limits
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.config.toml import nearest
from voodoo_jax.geometry.rigid import Poses, on_device
from voodoo_jax.model.body import Body, Mode, Topology, without_side
from voodoo_jax.model.checked_toml import BodyFileError as BodyFileError
from voodoo_jax.model.checked_toml import Table, TomlFile, unique_names
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.troubles import small_text

Vector = Float[np.ndarray, "3"]
HEADER = """\
# A body: degenerated cylinders (limbs) held together by elastic bands (joints).
# scale: metres; every other length here is a multiple of it. scale_name: what it is called, "stature" for people.
# Positions: body frame of the rest pose, z up, x forward, y left, origin on the floor below the body.
# [[limb]]    bottom, top: centres of the two ellipses, bottom nearest the parent; x_axis: direction of the first
#             semi-axis; bottom_axes, top_axes: the two semi-axes. The first limb is the root.
# [[joint]]   at: position, on the parent; child_at: on the child, if elsewhere; axes: semi-axes of the joint's ellipse,
#             both 0: universal, one 0: hinge about the other, none 0: elliptic; x_axis, z_axis (child_x_axis,
#             child_z_axis): directions of the ellipse's frame, default those of the body; weight: default 1.
#             swing_x, swing_y, twist: least and greatest angle in degrees that the child turns away from its rest pose,
#             about x and y of the joint's frame, and about its z; default no limit.
# [[centre]]  a joint centre that tracks report, carried by a limb. [[site]]: a feature point.
# [[segment]] a length to report, between two joints or centres; equal names are averaged.
# [[mode]]    how bodies of one scale differ together; changes: what one standard deviation of it changes, under the
#             names of a fit: logarithms of lengths.* and radii.*.bottom, radii.*.top, shares of the scale of
#             anchors.*.x, .y, .z; a name without l_ or r_ is both sides.
"""
MODES_LINE = "# Modes: how people of one stature differ (experiments/shape)."
# kind of table: (keys it must have, keys it may have)
KEYS = {
    "": (("name", "scale"), ("scale_name", "limb", "joint", "centre", "site", "segment", "mode")),
    "limb": (("name", "bottom", "top", "bottom_axes", "top_axes"), ("x_axis",)),
    "joint": (
        ("name", "parent", "child", "at", "axes"),
        ("child_at", "x_axis", "z_axis", "child_x_axis", "child_z_axis", "weight", "swing_x", "swing_y", "twist"),
    ),
    "centre": (("name", "limb", "at"), ()),
    "site": (("name", "limb", "at"), ()),
    "segment": (("name", "from", "to"), ()),
    "mode": (("name", "changes"), ()),
}
MOST = 1.0  # logarithm or share: no people of one size differ by a factor of e
LIMITS = ("swing_x", "swing_y", "twist")
RESERVED = ("name", "segment_lengths")  # keys of body_json in results, beside which the scale stands by its name
BUILT_IN = ("human", "human10", "arm", "dog", "stick")


class TextOfBody:
    """Lines of a body file; places are relative to `origin`, that of the body frame."""

    def __init__(self, scale: float, origin: Vector):
        self._scale, self._origin, self._lines = scale, origin, list[str]()

    def text(self) -> str:
        """All of it."""
        return "\n".join(self._lines) + "\n"

    def head(self, name: str, scale_name: str) -> None:
        """Lines before all tables."""
        self._lines += [f"name = {string_text(name)}", f"scale = {number_text(self._scale)}"]
        self._lines += [f"scale_name = {string_text(scale_name)}"]

    # 6 parameters: those of a limb in the file
    def limb(self, name: str, bottom: Vector, top: Vector, x_axis: Vector, bottom_axes, top_axes) -> None:
        """A limb between two points, with the semi-axes of its ends."""
        self._lines += ["", "[[limb]]", f"name = {string_text(name)}", f"bottom = {self._place(bottom)}"]
        self._lines += [f"top = {self._place(top)}", f"x_axis = {numbers_text(x_axis)}"]
        self._lines += [f"bottom_axes = {self._lengths(bottom_axes)}", f"top_axes = {self._lengths(top_axes)}"]

    def joint(self, name: str, parent: str, child: str, **values: Any) -> None:
        """A joint; `values` by the file's keys, in its order: at, child_at (places), axes (lengths), x_axis, z_axis,
        child_x_axis, child_z_axis (directions), swing_x, swing_y, twist (degrees), weight (a number)."""
        self._lines += ["", "[[joint]]", f"name = {string_text(name)}", f"parent = {string_text(parent)}"]
        self._lines += [f"child = {string_text(child)}"]
        for key, value in values.items():
            text = self._place if key.endswith("at") else self._lengths if key == "axes" else numbers_text
            self._lines += [f"{key} = {text(value) if np.ndim(value) else number_text(value)}"]

    def point(self, kind: str, name: str, limb: str, at: Vector) -> None:
        """A `centre`, which tracks report, or a `site`, a feature point."""
        self._lines += ["", f"[[{kind}]]", f"name = {string_text(name)}", f"limb = {string_text(limb)}"]
        self._lines += [f"at = {self._place(at)}"]

    def segment(self, name: str, start: str, end: str) -> None:
        """A length that is reported."""
        self._lines += ["", "[[segment]]", f"name = {string_text(name)}", f"from = {string_text(start)}"]
        self._lines += [f"to = {string_text(end)}"]

    def mode(self, name: str, changes: Iterable[tuple[str, float]]) -> None:
        """A variation among bodies of one scale."""
        table = ", ".join(f"{string_text(key)} = {number_text(value)}" for key, value in changes)
        self._lines += ["", "[[mode]]", f"name = {string_text(name)}", f"changes = {{ {table} }}"]

    def _place(self, at: np.ndarray) -> str:
        return numbers_text((np.asarray(at, float) - self._origin) / self._scale)

    def _lengths(self, values: np.ndarray) -> str:
        return numbers_text(np.asarray(values, float) / self._scale)


def number_text(value: float) -> str:
    """A number as body files have it."""
    text = f"{float(value) + 0.0:.9g}"  # + 0.0: no minus zero
    return text if any(c in text for c in ".e") else text + ".0"


def numbers_text(values: np.ndarray) -> str:
    """Numbers as body files have them."""
    return "[" + ", ".join(number_text(v) for v in np.round(values, 9) + 0.0) + "]"


def string_text(text: str) -> str:
    """A text as body files have it."""
    return json.dumps(text, ensure_ascii=False)


def load_body(name_or_path: str | os.PathLike) -> Body:
    """A built-in body ("human", "human10", "arm", "dog") or the body in a file. Raises BodyFileError."""
    return on_device(load_on_host(name_or_path))


def load_on_host(name_or_path: str | os.PathLike) -> Body:
    """As load_body, with NumPy arrays: does not use jax's device."""
    text = str(name_or_path)
    if text in BUILT_IN:
        return _built_in(text, limits())
    if not Path(text).exists() and Path(text).suffix == "" and Path(text).name == text:
        raise BodyFileError(text, None, f"no such file, and no built-in body of that name{nearest(text, BUILT_IN)}")
    return _read(name_or_path)


@cache
def _built_in(name: str, _: LimitSettings) -> Body:
    """Cached for the current limits: parsing takes a tenth of a second, and several callers need it."""
    resource = resources.files("voodoo_jax.model.bodies") / f"{name}.toml"
    return _parsed(resource.read_text(encoding="utf-8"), f"{name}.toml")


def human() -> Body:
    """The default body: a person of 15 limbs, sizes in proportion to `scale` (stature, metres)."""
    return load_body("human")


def read_body(path: str | os.PathLike) -> Body:
    """Reads a body file; lengths in metres, float32. Raises BodyFileError if it cannot be read or is no body."""
    return on_device(_read(path))


def _read(path: str | os.PathLike) -> Body:
    try:
        text = small_text(path)
    except OSError as error:
        raise BodyFileError(str(path), None, error.strerror or str(error)) from error
    except UnicodeDecodeError as error:
        raise BodyFileError(str(path), None, f"not UTF-8 text: {error.reason} at byte {error.start}") from error
    return _parsed(text, str(path))


def write_body(body: Body, path: str | os.PathLike) -> None:
    """Writes a body file that read_body turns into the same body (to 1e-6; rotations up to the quaternion's sign).

    The file appears under its name only when it is complete. Raises OSError.
    """
    with replacing(path) as partial:
        partial.write_text(format_body(body), encoding="utf-8")


def parse_body(text: str, source: str = "<text>") -> Body:
    """Body from the text of a body file; `source` names it in errors. Raises BodyFileError."""
    return on_device(_parsed(text, source))


# 68 lines: one table of the file after the other
def _parsed(text: str, source: str) -> Body:
    file = TomlFile(text, source, KEYS, BodyFileError)
    root = file.root()
    scale = root.number("scale", above=0)
    if not SIZES[0] <= scale <= SIZES[1]:
        root.fail("scale", f"a body of {scale:g} m; sizes from {SIZES[0]:g} to {SIZES[1]:g} m are supported")
    scale_name = root.string("scale_name", "scale")
    if scale_name in RESERVED:
        root.fail("scale_name", f"'{scale_name}' cannot be the name of the scale: results use it for something else")
    tables = {kind: file.tables(kind) for kind in KEYS if kind}
    if not tables["limb"]:
        file.fail(None, "a body needs at least one [[limb]]")
    if len(tables["limb"]) > limits().limbs:
        file.fail(None, f"{len(tables['limb'])} limbs, more than {limits().limbs} (--limits.limbs)")
    limbs, joints = unique_names(tables["limb"]), unique_names(tables["joint"])
    centres, sites = unique_names(tables["centre"]), unique_names(tables["site"])
    unique_names(tables["mode"])

    bottoms, tops = ([t.numbers(key, 3) for t in tables["limb"]] for key in ("bottom", "top"))
    rotations, sizes = [], []
    for table, bottom, top in zip(tables["limb"], bottoms, tops):
        length = float(np.linalg.norm(top - bottom))
        if length < 1e-6:
            table.fail("top", f"limb '{table.name}' has no length: bottom and top are the same point")
        z = (top - bottom) / length
        rotations.append(table.frame("x_axis", z, np.array([1.0, 0, 0] if abs(z[0]) < 0.9 else [0, 0, 1.0])))
        sizes.append([*table.numbers("bottom_axes", 2, above=0), *table.numbers("top_axes", 2, above=0), length])
    rest = _poses(rotations, bottoms, scale)

    parents = tuple(t.index("parent", limbs, "limb") for t in tables["joint"])
    children = tuple(t.index("child", limbs, "limb") for t in tables["joint"])
    _check_tree(tables["limb"], tables["joint"], limbs, parents, children)
    at = [t.numbers("at", 3) for t in tables["joint"]]
    child_at = [t.numbers("child_at", 3) if "child_at" in t.data else p for t, p in zip(tables["joint"], at)]
    ex, ez = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    frames = [t.frame("x_axis", t.numbers("z_axis", 3, default=ez), ex) for t in tables["joint"]]
    child_frames = [
        t.frame("child_x_axis", t.numbers("child_z_axis", 3, default=f[:, 2]), f[:, 0])
        for t, f in zip(tables["joint"], frames)
    ]

    def carried(kind: str) -> tuple[tuple[int, ...], np.ndarray]:
        found = tuple(t.index("limb", limbs, "limb") for t in tables[kind])
        points = np.array([t.numbers("at", 3) for t in tables[kind]]).reshape(-1, 3) * scale
        local = [rotations[i].T @ (p - bottoms[i] * scale) for i, p in zip(found, points)]
        return found, np.array(local).reshape(-1, 3)

    centre_limbs, centre_points = carried("centre")
    site_limbs, site_points = carried("site")
    known = (*joints, *centres)
    ends = [tuple(t.index(key, known, "joint or centre") for key in ("from", "to")) for t in tables["segment"]]
    topology = Topology(
        limbs=limbs, joints=joints, parents=parents, children=children, centres=centres, centre_limbs=centre_limbs,
        sites=sites, site_limbs=site_limbs,
        segments=tuple((t.name, known[i], known[j]) for t, (i, j) in zip(tables["segment"], ends)),
    )  # fmt: skip

    def array(x, *shape) -> Any:  # pyright expects jax's
        return np.array(x, np.float32).reshape(shape)

    return Body(
        sizes=array(np.array(sizes) * scale, -1, 5),
        rest=_to_poses(rest),
        parent_anchor=_to_poses(_relative(rest, parents, _poses(frames, at, scale))),
        child_anchor=_to_poses(_relative(rest, children, _poses(child_frames, child_at, scale))),
        axes=array(np.array([t.numbers("axes", 2, above=-1e-300) for t in tables["joint"]]) * scale, -1, 2),
        weights=array([t.number("weight", above=0, default=1.0) for t in tables["joint"]], -1),
        centres=array(centre_points, -1, 3),
        sites=array(site_points, -1, 3),
        scale=array(scale),
        limits=array([_limits(t) for t in tables["joint"]], -1, 3, 2),
        presence=array([1.0] * len(limbs), -1),
        topology=topology,
        name=root.name,
        scale_name=scale_name,
        modes=tuple(_mode(t, limbs, joints) for t in tables["mode"]),
    )


def _mode(table: Table, limbs: tuple[str, ...], joints: tuple[str, ...]) -> Mode:
    """One variation among bodies; every change names a limb or joint of the body."""
    changes = table.data["changes"]
    if not isinstance(changes, dict) or not changes:
        table.fail("changes", f"'changes' of {table.title} must be a table of names and numbers, not {changes!r}")
    known = set(size_names(limbs, joints))
    for name, value in changes.items():
        if name not in known:
            table.fail("changes", f"'changes' of {table.title}: there is no '{name}'{nearest(name, sorted(known))}")
        if type(value) not in (int, float) or not abs(value) < MOST:
            table.fail("changes", f"'{name}' of {table.title} must be a number from -{MOST} to {MOST}, not {value!r}")
    return Mode(table.name, tuple((name, float(value)) for name, value in changes.items()))


def size_names(limbs: tuple[str, ...], joints: tuple[str, ...]) -> list[str]:
    """Names that a mode may change, each with its side and without."""
    limbs, joints = (
        tuple(dict.fromkeys(n for name in names for n in (name, without_side(name)))) for names in (limbs, joints)
    )
    ends = [f"radii.{limb}.{end}" for limb in limbs for end in ("bottom", "top")]
    return [f"lengths.{limb}" for limb in limbs] + ends + [f"anchors.{joint}.{a}" for joint in joints for a in "xyz"]


def format_body(body: Body) -> str:
    """Text of the body file of a body (see write_body)."""
    sizes, axes, weights = (np.asarray(x, np.float64) for x in (body.sizes, body.axes, body.weights))
    t, (turns, places), text = body.topology, _from_poses(body.rest), TextOfBody(float(body.scale), np.zeros(3))
    text.head(body.name, body.scale_name)
    for name, rotation, bottom, size in zip(t.limbs, turns, places, sizes):
        text.limb(name, bottom, bottom + rotation[:, 2] * size[4], rotation[:, 0], size[:2], size[2:4])
    anchors = [(t.parents, _from_poses(body.parent_anchor)), (t.children, _from_poses(body.child_anchor))]
    for j, name in enumerate(t.joints):
        values = {}
        for prefix, (owner, (rotation, translation)) in zip(("", "child_"), anchors):
            limb = owner[j]
            frame, at = turns[limb] @ rotation[j], turns[limb] @ translation[j] + places[limb]
            values |= {f"{prefix}at": at, f"{prefix}x_axis": frame[:, 0], f"{prefix}z_axis": frame[:, 2]}
        limits = np.round(np.degrees(np.asarray(body.limits, np.float64)[j]), 4)
        values |= {"axes": axes[j], "weight": float(weights[j])}
        values |= {key: row for key, row in zip(LIMITS, limits) if np.isfinite(row).all()}
        text.joint(name, t.limbs[t.parents[j]], t.limbs[t.children[j]], **values)
    named = (("centre", t.centres, t.centre_limbs, body.centres), ("site", t.sites, t.site_limbs, body.sites))
    for kind, names, owner, points in named:
        for name, limb, point in zip(names, owner, np.asarray(points, np.float64)):
            text.point(kind, name, t.limbs[limb], turns[limb] @ point + places[limb])
    for name, start, end in t.segments:
        text.segment(name, start, end)
    for name, changes in body.modes:
        text.mode(name, changes)
    return f"{HEADER}\n{text.text()}"


def _limits(table: Table) -> np.ndarray:
    """Least and greatest swing about x and y, and twist, of a joint; radians."""
    out = np.array([[-np.inf, np.inf]] * 3)
    for row, key in zip(out, LIMITS):
        if key in table.data:
            row[:] = np.radians(table.numbers(key, 2))
            if not -180 <= table.data[key][0] <= 0 <= table.data[key][1] <= 180:
                table.fail(key, f"'{key}' of {table.title} must be degrees from -180..0 to 0..180: 0 is the rest pose")
    return out


def _check_tree(
    limbs: list[Table], joints: list[Table], names: tuple[str, ...], parents: tuple[int, ...], children: tuple[int, ...]
) -> None:
    above: dict[int, int] = {}
    for table, parent, child in zip(joints, parents, children):
        if child == 0:
            table.fail("child", f"{table.title}: limb '{names[0]}' is the root (the first limb) and cannot be a child")
        if child in above:
            table.fail("child", f"{table.title}: limb '{names[child]}' already has the parent '{names[above[child]]}'")
        above[child] = parent
    for i, table in enumerate(limbs):
        path = [i]
        while path[-1] != 0:
            if path[-1] not in above:
                limbs[path[-1]].fail("", f"limb '{names[path[-1]]}' has no parent: no joint has it as child")
            path.append(above[path[-1]])
            if path[-1] in path[:-1]:
                table.fail("", f"limb '{names[i]}' is in a loop: {' on '.join(names[p] for p in path)}")


_Frames = tuple[np.ndarray, np.ndarray]  # rotation matrices [n, 3, 3] and translations [n, 3] in float64


def _poses(rotations: list[np.ndarray], points: list[np.ndarray], scale: float) -> _Frames:
    return np.array(rotations).reshape(-1, 3, 3), np.array(points).reshape(-1, 3) * scale


def _relative(rest: _Frames, owner: tuple[int, ...], frames: _Frames) -> _Frames:
    """Frames given in the body frame, seen from the limbs that own them."""
    rotation, translation = rest[0][list(owner)], rest[1][list(owner)]
    turned = np.einsum("nji,njk->nik", rotation, frames[0])
    return turned, np.einsum("nji,nj->ni", rotation, frames[1] - translation)


def _to_poses(frames: _Frames) -> Poses:
    q = Rotation.from_matrix(frames[0]).as_quat(scalar_first=True, canonical=True)
    return Poses(q.reshape(-1, 4).astype(np.float32), frames[1].astype(np.float32))


def _from_poses(poses: Poses) -> _Frames:
    turns = Rotation.from_quat(np.asarray(poses.rotation, np.float64).reshape(-1, 4), scalar_first=True)
    return turns.as_matrix(), np.asarray(poses.translation, np.float64)
