"""Recognises messages of drivers' own types by their fields (Livox clouds, motion capture markers, RGBD images, ZED
bodies)."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from voodoo_jax.io.decode import depth
from voodoo_jax.model.marker_names import numbered_names
from voodoo_jax.records.messages import PAIRS, Cloud, Features, Image, Named, features, frame_name, ros_stamp, xyz

IMAGE, CLOUD, CAMERA = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"
HEADER = "std_msgs/msg/Header"
# packages whose messages are known: what of theirs is not read holds no measurements (polygons, paths, plans)
_KNOWN = (
    "geometry_msgs", "nav_msgs", "visualization_msgs", "vision_msgs", "std_msgs", "diagnostic_msgs", "trajectory_msgs",
    "sensor_msgs", "stereo_msgs", "tf2_msgs", "map_msgs", "shape_msgs", "rosgraph_msgs", "rcl_interfaces",
)  # fmt: skip
_ZED = {0: 18, 1: 34, 2: 38}  # how many key points each BODY_FORMAT of the ZED SDK has
_PLACES = ("geometry_msgs/msg/Point", "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Point32")
_POSES = ("geometry_msgs/msg/Pose", "geometry_msgs/msg/Transform")


def _fields(store: Typestore, name: str) -> dict[str, Any]:
    return dict(store.fielddefs[name][1]) if name in store.fielddefs else {}


def _of(store: Typestore, name: str, *types: str) -> list[str]:
    """Fields of a message that are of one of these types."""
    return [field for field, (kind, sub) in _fields(store, name).items() if kind == Nodetype.NAME and sub in types]


def _lists(store: Typestore, name: str) -> list[tuple[str, str]]:
    """Fields that are lists of messages, and the type of these."""
    found = _fields(store, name).items()
    lists = [(f, sub[0]) for f, (kind, sub) in found if kind in (Nodetype.SEQUENCE, Nodetype.ARRAY)]
    return [(field, sub[1]) for field, sub in lists if sub[0] == Nodetype.NAME]


def _key_points(store: Typestore, name: str) -> tuple[str, str, str] | None:
    """Fields of a body in which its key points are: its skeleton, the list in that, and the place, three numbers."""
    for skeleton, (kind, sub) in _fields(store, name).items():
        if kind != Nodetype.NAME:
            continue
        for points, own in _lists(store, sub):
            for place, (array, content) in _fields(store, own).items():
                if array == Nodetype.ARRAY and content[1] == 3 and "point" in points:
                    return skeleton, points, place
    return None


def _numbers(store: Typestore, name: str) -> set[str]:
    found = _fields(store, name).items()
    return {f for f, (kind, sub) in found if kind == Nodetype.BASE and sub[0].startswith("float")}


def _strings(store: Typestore, name: str) -> list[str]:
    found = _fields(store, name).items()
    return [f for f, (kind, sub) in found if kind == Nodetype.BASE and sub[0] == "string"]


def starts_with_header(store: Typestore, name: str) -> bool:
    """Whether the first field of a message is a header."""
    return next(iter(_fields(store, name).values()), None) == (Nodetype.NAME, HEADER)


def by_fields(store: Typestore, name: str) -> tuple[str, Callable[[Any], Any] | None]:
    """The use of messages of this type, as in `registry.KINDS`, and a function that converts one to an Image, Cloud or
    Features; "" and None if its fields fit none."""
    if name.split("/")[0] in _KNOWN and name != "sensor_msgs/msg/PointCloud":
        return "", None
    images = [field for field in _of(store, name, IMAGE) if "depth" in field.lower()]
    if images:
        cameras = _of(store, name, CAMERA)
        camera = next((c for c in cameras if "depth" in c.lower()), cameras[0] if cameras else "")
        return "image", lambda m: _image(m, images[0], camera)
    if clouds := _of(store, name, CLOUD):
        return "point cloud", lambda m: depth.CONVERTERS[CLOUD][1](getattr(m, clouds[0]))
    for field, kind in _lists(store, name):
        names = sorted((s for s in _strings(store, kind) if "name" in s or "label" in s), key=lambda s: "subject" in s)
        names = [s for s in names if "subject" not in s and "segment" not in s]
        place = next(iter(_of(store, kind, *_PLACES, *_POSES)), "")
        own = {"x", "y", "z"} <= _numbers(store, kind)
        if names and (place or own):
            marker = next((s for s in names if "marker" in s), names[0])
            return PAIRS, partial(_named, items=field, name=marker, place=place)
        if key_points := _key_points(store, kind):
            return PAIRS, partial(_bodies, items=field, path=key_points)
        if own:
            return "point cloud", partial(_cloud, points=field)
    return "", None


def _stamp(m: Any) -> tuple[int, str]:
    header = getattr(m, "header", None)
    return (ros_stamp(header), frame_name(header.frame_id)) if header is not None else (0, "")


def _image(m: Any, image: str, camera: str) -> Image:
    found, (stamp, frame) = depth.CONVERTERS[IMAGE][1](getattr(m, image)), _stamp(m)
    calibration = depth.CONVERTERS[CAMERA][1](getattr(m, camera)) if camera else None
    if calibration is not None and calibration.K[0, 0] <= 0:
        calibration = None
    # some drivers fill in the outer header only
    return replace(found, stamp_ns=found.stamp_ns or stamp, frame=found.frame or frame, calibration=calibration)


def _cloud(m: Any, points: str) -> Cloud:
    (stamp, frame), found = _stamp(m), getattr(m, points)
    grid = np.zeros((1, len(found)), np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4")]))
    for axis in "xyz":
        grid[axis] = [getattr(point, axis) for point in found]
    return Cloud(stamp, frame, grid)


def _bodies(m: Any, items: str, path: tuple[str, str, str]) -> Features:
    """Bodies whose key points have no names, but an order. There is room for those of the largest format; what a
    smaller one leaves, and what is hidden, is NaN or zero."""
    stamp, frame = _stamp(m)
    skeleton, points, place = path
    found = []
    for number, body in enumerate(getattr(m, items)):
        at = np.array([getattr(p, place) for p in getattr(getattr(body, skeleton), points)], float).reshape(-1, 3)
        there = np.isfinite(at).all(1) & (at != 0).any(1)
        last = int(np.flatnonzero(there)[-1]) + 1 if there.any() else 0
        # the last points of a format are often hidden: what is there does not tell it
        formats = (_ZED.get(getattr(body, "body_format", -1), 0), len(at), *_ZED.values())
        names = next((n for count in formats if count >= last and (n := numbered_names(count))), ())
        who = next((getattr(body, k) for k in ("label_id", "tracking_id", "id") if hasattr(body, k)), number)
        found += [Named(f"body{who}:{n}", "", frame, stamp, p) for n, p, ok in zip(names, at, there) if ok]
    return features(stamp, found, 3)


def _named(m: Any, items: str, name: str, place: str) -> Features:
    stamp, frame = _stamp(m)
    found = []
    for item in getattr(m, items):
        at = getattr(item, place) if place else item
        at = getattr(at, "position", getattr(at, "translation", at))
        if getattr(item, "occluded", False) or not getattr(item, name):
            continue
        subject = str(getattr(item, "subject_name", "") or "")
        label = f"{subject}:{getattr(item, name)}" if subject else str(getattr(item, name))
        found.append(Named(label, "", frame, stamp, xyz(at)))
    return features(stamp, found, 3)
