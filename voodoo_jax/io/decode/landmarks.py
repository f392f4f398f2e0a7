"""Messages of named features as plain NumPy: detections and annotations in images, points, markers, scenes."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.model.marker_names import JOINT, orders
from voodoo_jax.records.messages import (
    PAIRS,
    RAYS,
    Features,
    Named,
    features,
    frame_name,
    pb_stamp,
    ros_stamp,
    xyz,
    xyzw,
)

# visualization_msgs/msg/Marker
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3
_ARROW, _LISTS = 0, (6, 7, 8)  # lists: cubes, spheres, points
_SINGLE = (_ARROW, 1, 2, 3, 9, 10)  # cube, sphere, cylinder, text, mesh
# foxglove.PointsAnnotation
_POINTS, _LINE_LOOP = 1, 2


def _detections(m: Any) -> Features:
    items = []
    for d in m.detections:
        score, name = max((_hypothesis(r) for r in d.results), key=lambda h: h[0], default=(0.0, ""))
        if not name:
            continue
        center = d.bbox.center
        at = getattr(center, "position", center)  # version 4 of vision_msgs; up to 3 the numbers stand here
        if at.x == at.y == d.bbox.size_x == d.bbox.size_y == 0:
            continue  # nobody filled in the box
        frame = frame_name(m.header.frame_id or d.header.frame_id)
        items.append(Named(name, "", frame, ros_stamp(m.header) or ros_stamp(d.header), (at.x, at.y), score))
    return features(ros_stamp(m.header), items, 2)


def _hypothesis(result: Any) -> tuple[float, str]:
    """Score and name, in any release of vision_msgs: class_id or id (once a number), in `hypothesis` or beside it."""
    h = getattr(result, "hypothesis", result)
    name = getattr(h, "class_id", None)
    score = float(h.score)
    return -np.inf if np.isnan(score) else score, str(getattr(h, "id", "") if name is None else name)


def _annotations(m: Any) -> Features:
    marks = [(pb_stamp(c), (c.position.x, c.position.y)) for c in m.circles]
    points = [(pb_stamp(a), (p.x, p.y)) for a in m.points if a.type == _POINTS for p in a.points]
    boxes = []
    for a in m.points:
        if a.type == _LINE_LOOP and a.points:
            corners = np.array([(p.x, p.y) for p in a.points])
            boxes.append((pb_stamp(a), tuple((corners.min(axis=0) + corners.max(axis=0)) / 2)))
    found = next((f for f in (marks, points, marks + points, boxes) if len(f) == len(m.texts)), None)
    if found is None:
        raise ValueError(
            f"{len(m.texts)} texts cannot be the names of {len(marks)} circles, {len(points)} points or "
            f"{len(boxes)} boxes"
        )
    items = [Named(t.text, "", "", stamp or pb_stamp(t), pixel) for (stamp, pixel), t in zip(found, m.texts) if t.text]
    return features(pb_stamp(m), items, 2)


def _missing(position: np.ndarray, *flags: Any) -> bool:
    """Whether a place of exactly zero was never filled in: a flag beside it (colour's alpha, quaternion) is 0 too."""
    return not np.any(position) and any(not np.any(f) for f in flags)


def _ros_point(m: Any) -> Features:
    stamp = ros_stamp(m.header)
    return features(stamp, [Named("", "", frame_name(m.header.frame_id), stamp, xyz(m.point))], 3)


def _ros_pose(m: Any) -> Features:
    stamp, place = ros_stamp(m.header), xyz(m.pose.position)
    missing = _missing(place, xyzw(m.pose.orientation))
    return features(stamp, [] if missing else [Named("", "", frame_name(m.header.frame_id), stamp, place)], 3)


def _markers(markers: Any) -> Features:
    shown: dict[tuple[str, int], list[Named]] = {}
    for m in markers:
        if m.action == _DELETE_ALL:
            shown.clear()
        elif m.action == _DELETE:
            shown.pop((m.ns, m.id), None)
        elif m.action == _ADD:
            shown[m.ns, m.id] = _marker(m)
    items = [item for group in shown.values() for item in group]
    return features(ros_stamp(markers[0].header) if len(markers) else 0, items, 3)


def _marker(m: Any) -> list[Named]:
    frame, stamp, label = frame_name(m.header.frame_id), ros_stamp(m.header), m.text.strip() or str(m.id)
    place, q = xyz(m.pose.position), xyzw(m.pose.orientation)
    name, suffix = (m.ns, label) if m.ns else (label, "")
    if m.type in _LISTS:
        rotation = Rotation.from_quat(q).as_matrix() if np.any(q) else np.eye(3)
        colours = m.colors if len(m.colors) == len(m.points) else [m.color] * len(m.points)
        return [
            Named(name, f"{suffix}/{i}" if suffix else str(i), frame, stamp, rotation @ xyz(p) + place)
            for i, (p, c) in enumerate(zip(m.points, colours))
            if not _missing(xyz(p), c.a)
        ]
    if m.type not in _SINGLE or (m.type == _ARROW and len(m.points)) or _missing(place, m.color.a, q):
        return []
    return [Named(name, suffix, frame, stamp, place)]


def _ros_poses(m: Any) -> Features:
    """Joints of a body without names, identified by their number; other arrays (particles, paths) are not joints."""
    count, stamp = len(m.poses), ros_stamp(m.header)
    items, frame = [], frame_name(m.header.frame_id)
    for number, pose in enumerate(m.poses if orders(count) else ()):
        place = xyz(pose.position)
        if not _missing(place, xyzw(pose.orientation)):
            items.append(Named(f"{JOINT.format(count)}{number}", "", frame, stamp, place))
    return features(stamp, items, 3)


def _foxglove_point(m: Any) -> Features:
    found = [Named("", "", frame_name(m.frame_id), pb_stamp(m), xyz(m.point))] if m.HasField("point") else []
    return features(pb_stamp(m), found, 3)


def _foxglove_poses(m: Any, poses: Any) -> Features:
    items = []
    for i, pose in enumerate(poses):
        place = xyz(pose.position)
        if not _missing(place, xyzw(pose.orientation)):
            items.append(Named("", str(i), frame_name(m.frame_id), pb_stamp(m), place))
    return features(pb_stamp(m), items, 3)


def _scene(m: Any) -> Features:
    items = []
    for entity in m.entities:
        solids, texts = [*entity.spheres, *entity.cubes], entity.texts
        shapes = solids or texts
        labels = [t.text.strip() for t in texts] if len(texts) == len(shapes) else [""] * len(shapes)
        for i, (shape, label) in enumerate(zip(shapes, labels)):
            place = xyz(shape.pose.position)
            if not _missing(place, shape.color.a):
                items.append(Named(entity.id, label or str(i), frame_name(entity.frame_id), pb_stamp(entity), place))
    return features(pb_stamp(m.entities[0]) if m.entities else 0, items, 3)


CONVERTERS = {
    "vision_msgs/msg/Detection2DArray": (RAYS, _detections),
    "geometry_msgs/msg/PointStamped": (PAIRS, _ros_point),
    "geometry_msgs/msg/PoseStamped": (PAIRS, _ros_pose),
    "geometry_msgs/msg/PoseArray": (PAIRS, _ros_poses),
    "visualization_msgs/msg/Marker": (PAIRS, lambda m: _markers([m])),
    "visualization_msgs/msg/MarkerArray": (PAIRS, lambda m: _markers(m.markers)),
    "foxglove.ImageAnnotations": (RAYS, _annotations),
    "foxglove.Point3InFrame": (PAIRS, _foxglove_point),
    "foxglove.PoseInFrame": (PAIRS, lambda m: _foxglove_poses(m, [m.pose] if m.HasField("pose") else [])),
    "foxglove.PosesInFrame": (PAIRS, lambda m: _foxglove_poses(m, m.poses)),
    "foxglove.SceneUpdate": (PAIRS, _scene),
}
