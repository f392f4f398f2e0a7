"""Robot descriptions (URDF) as bodies. The format: wiki.ros.org/urdf/XML."""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from voodoo_jax.config.toml import nearest
from voodoo_jax.model.checked_toml import BodyFileError
from voodoo_jax.model.foreign.assembly import Piece, assembled
from voodoo_jax.model.foreign.sources import folder_of
from voodoo_jax.storage.troubles import small_file

MESHES = (".stl", ".dae", ".obj", ".ply", ".glb", ".gltf", ".off")  # no archives
SAMPLES = 2000  # points on each link, some millimetres apart on limbs of people's size
TURNING = ("revolute", "continuous")
RIGID = "fixed"
SLIDING = "prismatic"


@dataclass
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    origin: np.ndarray  # T_parent_joint
    axis: np.ndarray
    limits: tuple[float, float] | None  # radians


_Found = tuple[dict[str, np.ndarray], dict[str, float]]  # T_world_link of links, values of joints


@dataclass
class _Link:
    """A link, or several that are connected rigidly, in the world frame of the rest pose."""

    points: np.ndarray
    normals: np.ndarray

    @property
    def extent(self) -> float:
        return float(np.ptp(self.points, axis=0).max()) if len(self.points) else 0.0


def read_urdf(path: Path, rest: dict[str, float], least: float) -> tuple[str, list[str]]:
    """The text of a body file: see sources.body_from. Links without surface and fixed joints are merged with their
    parent."""
    try:
        root = ElementTree.fromstring(small_file(path))
    except (ElementTree.ParseError, OSError) as problem:
        raise BodyFileError(str(path), None, f"it cannot be read as XML: {problem}") from problem
    if root.tag != "robot":
        raise BodyFileError(str(path), None, f"its root is <{root.tag}>, not <robot>: expand xacro files first")
    try:
        return _body_of(root, path, rest, least)
    except (KeyError, ValueError, AttributeError) as problem:
        if isinstance(problem, BodyFileError):
            raise
        raise BodyFileError(str(path), None, f"it cannot be read as URDF: {problem}") from problem


def _body_of(root: ElementTree.Element, path: Path, rest: dict[str, float], least: float) -> tuple[str, list[str]]:
    joints = [_joint(element) for element in root.findall("joint")]
    names = [element.attrib["name"] for element in root.findall("link")]
    if unknown := set(rest) - {joint.name for joint in joints}:
        first = sorted(unknown)[0]
        raise BodyFileError(
            str(path), None, f"it has no joint '{first}'{nearest(first, tuple(j.name for j in joints))}"
        )
    roots = [name for name in names if name not in {joint.child for joint in joints}]
    if len(roots) != 1:
        raise BodyFileError(str(path), None, f"it needs one link without a parent; there are {roots}")
    notes: list[str] = []
    values = {joint.name: _value(joint, rest) for joint in joints}
    places = _placed(roots[0], joints, values)
    surfaces = {
        element.attrib["name"]: _surface(element, places[element.attrib["name"]], path, notes)
        for element in root.findall("link")
        if element.attrib["name"] in places
    }
    tree = _Tree(joints, surfaces, (places, values), least, notes)
    tree.add(roots[0], -1, [])
    if not len(tree.pieces[0].points):
        raise BodyFileError(str(path), None, f"the root '{roots[0]}' has no surface; {'; '.join(notes)}".rstrip("; "))
    body, more = assembled(tree.pieces, root.attrib.get("name", path.stem), "reach", str(path))
    return body, notes + more


def _joint(element: ElementTree.Element) -> _Joint:
    ends = [element.find(kind) for kind in ("parent", "child")]
    if any(end is None for end in ends):
        raise ValueError(f"joint '{element.attrib.get('name')}' has no parent or child")
    axis, limit = element.find("axis"), element.find("limit")
    kind = element.attrib["type"]
    limits = None
    if kind in ("revolute", SLIDING) and limit is not None:
        limits = float(limit.attrib.get("lower", 0)), float(limit.attrib.get("upper", 0))
    return _Joint(
        element.attrib["name"], kind, ends[0].attrib["link"], ends[1].attrib["link"],  # type: ignore[union-attr]
        _pose(element.find("origin")), _numbers(axis, "xyz", (1, 0, 0)), limits,
    )  # fmt: skip


def _numbers(element: ElementTree.Element | None, key: str, default: tuple[float, ...]) -> np.ndarray:
    text = None if element is None else element.attrib.get(key)
    found = np.array(default if text is None else [float(word) for word in text.split()], float)
    if found.shape != (len(default),):
        raise ValueError(f"'{text}' must be {len(default)} numbers")
    return found


def _pose(origin: ElementTree.Element | None) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("xyz", _numbers(origin, "rpy", (0, 0, 0))).as_matrix()
    out[:3, 3] = _numbers(origin, "xyz", (0, 0, 0))
    return out


def _value(joint: _Joint, rest: dict[str, float]) -> float:
    """Value of a joint in the rest pose: as requested, or the nearest to 0."""
    low, high = joint.limits or (-np.inf, np.inf)
    value = rest.get(joint.name, float(np.clip(0.0, low, high)) if low <= high else 0.0)
    if joint.name in rest and joint.limits and not low <= value <= high:
        raise ValueError(f"joint '{joint.name}' goes from {low:g} to {high:g}, not to {value:g}")
    return value


def _moved(joint: _Joint, value: float) -> np.ndarray:
    out, axis = np.eye(4), joint.axis / max(float(np.linalg.norm(joint.axis)), 1e-12)
    if joint.kind in TURNING:
        out[:3, :3] = Rotation.from_rotvec(axis * value).as_matrix()
    elif joint.kind == SLIDING:
        out[:3, 3] = axis * value
    return joint.origin @ out


def _placed(root: str, joints: list[_Joint], values: dict[str, float]) -> dict[str, np.ndarray]:
    """T_world_link of all descendants of the root."""
    places, left = {root: np.eye(4)}, list(joints)
    while ready := [joint for joint in left if joint.parent in places]:
        for joint in ready:
            places[joint.child] = places[joint.parent] @ _moved(joint, values[joint.name])
            left.remove(joint)
    return places


def _surface(link: ElementTree.Element, place: np.ndarray, path: Path, notes: list[str]) -> _Link:
    """Points on the surface of a link: of its visual geometry, or else of its collision geometry."""
    found: list[trimesh.Trimesh] = []
    for kind in ("visual", "collision"):
        for element in link.findall(kind):
            geometry = element.find("geometry")
            mesh = None if geometry is None or not len(geometry) else _mesh(geometry[0], path, notes)
            if mesh is not None and len(mesh.faces):
                found.append(mesh.apply_transform(place @ _pose(element.find("origin"))))
        if found:
            break
    if not found:
        return _Link(np.zeros((0, 3)), np.zeros((0, 3)))
    whole = trimesh.util.concatenate(found)
    points, faces = trimesh.sample.sample_surface_even(whole, SAMPLES, seed=0)
    if len(points) < SAMPLES // 4:  # small parts are not spread evenly
        points, faces = trimesh.sample.sample_surface(whole, SAMPLES, seed=0)[:2]
    normals = whole.face_normals[faces]  # type: ignore[attr-defined]
    return _Link(np.asarray(points, float), np.asarray(normals, float))


def _mesh(shape: ElementTree.Element, path: Path, notes: list[str]) -> trimesh.Trimesh | None:
    if shape.tag == "box":
        return trimesh.creation.box(_numbers(shape, "size", (1, 1, 1)))
    if shape.tag == "sphere":
        return trimesh.creation.icosphere(3, float(shape.attrib["radius"]))
    if shape.tag in ("cylinder", "capsule"):
        make = trimesh.creation.cylinder if shape.tag == "cylinder" else trimesh.creation.capsule
        return make(radius=float(shape.attrib["radius"]), height=float(shape.attrib["length"]))
    if shape.tag != "mesh":
        notes.append(f"a shape <{shape.tag}> was left out")
        return None
    file = _file(shape.attrib["filename"], path)
    try:
        if file.suffix.lower() not in MESHES:
            raise ValueError(f"supported are {', '.join(MESHES)}")
        content = BytesIO(small_file(file, folder_of(path)))
        mesh = trimesh.load(content, file_type=file.suffix[1:].lower(), force="mesh")
    except Exception as problem:  # trimesh has no error of its own
        notes.append(f"the mesh '{shape.attrib['filename']}' cannot be read: {type(problem).__name__}: {problem}")
        return None
    return mesh.apply_transform(np.diag([*_numbers(shape, "scale", (1, 1, 1)), 1]))  # type: ignore[union-attr]


def _file(name: str, path: Path) -> Path:
    """Path of a mesh: beside the URDF, or in its package, which is a folder above it."""
    if not name.startswith("package://"):
        return path.parent / name.removeprefix("file://")
    package, _, rest = name.removeprefix("package://").partition("/")
    root = folder_of(path)
    for folder in path.resolve().parents:
        if not folder.is_relative_to(root):
            break
        for place in (folder / package / rest, folder / rest):
            if place.exists():
                return place
    return path.parent / rest


class _Tree:
    """Links that move on their own and are visible, parents first; others are merged with their parent."""

    def __init__(self, joints: list[_Joint], surfaces: dict[str, _Link], found: _Found, least: float, notes: list[str]):
        self.joints, self.surfaces, self.found, self.least, self.notes = joints, surfaces, found, least, notes
        self.pieces: list[Piece] = []

    def add(self, link: str, above: int, between: list[_Joint]) -> None:
        """Adds a link and all its descendants; `above`: the piece before it, `between`: the joints that turn it
        there."""
        surface = self.surfaces[link]
        if above < 0 or (between and surface.extent >= self.least):
            self.pieces.append(_piece(link, above, between, surface, self.found))
            above, between = len(self.pieces) - 1, []
        elif len(surface.points):
            old = self.pieces[above]
            self.pieces[above] = old.with_surface(surface.points, surface.normals)
            if between:
                self.notes.append(f"'{link}' is small: merged with '{old.name}'")
        for joint in self.joints:
            if joint.parent == link:
                if joint.kind == SLIDING:
                    self.notes.append(f"'{joint.name}' is prismatic: it keeps its rest pose, as limbs cannot slide")
                turns = [joint] if joint.kind not in (RIGID, SLIDING) else []
                self.add(joint.child, above, [*between, *turns])


def _piece(link: str, above: int, between: list[_Joint], surface: _Link, found: _Found) -> Piece:
    """A link with its joints to the parent: one is a hinge, several with nothing between turn freely."""
    places, values = found
    if not between:
        return Piece(link, above, surface.points, surface.normals)
    last = between[-1]
    at = places[last.child][:3, 3]
    if len(between) > 1 or last.kind not in TURNING:
        return Piece(link, above, surface.points, surface.normals, last.name, at)
    axis = (places[last.parent] @ last.origin)[:3, :3] @ last.axis
    limits = None
    if last.limits is not None:
        low, high = (float(np.degrees(limit - values[last.name])) for limit in last.limits)
        limits = (min(low, 0.0), max(high, 0.0))
    return Piece(link, above, surface.points, surface.normals, last.name, at, axis, limits)
