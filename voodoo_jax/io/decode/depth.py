"""Depth messages of ROS 2 and Foxglove as plain NumPy: clouds, images, laser scans, calibrations, transforms."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.config.limited import too_large
from voodoo_jax.geometry.arrays_file import array_at
from voodoo_jax.io.decode.image_codec import PIXELS, colour_image
from voodoo_jax.io.transforms import Transform, plausible
from voodoo_jax.records.messages import (
    DEPTH_ENCODINGS,
    Calibration,
    Cloud,
    Image,
    Unusable,
    frame_name,
    pb_stamp,
    ros_stamp,
    xyz,
    xyzw,
)

# Signed and unsigned are swapped between the two: ROS INT8=1, UINT8=2; Foxglove UINT8=1, INT8=2.
_ROS_FIELDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
DISPARITY = "disparity"  # the encoding of depth that was computed from it
_AXES = ("x", "y", "z")
_FOXGLOVE_FIELDS = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


def ros_cloud(m: Any, data: Any = None) -> Cloud:
    """A cloud of ROS; `data`: its unpacked bytes, if the message is compressed."""
    fields = {f.name: (_ROS_FIELDS.get(f.datatype), f.offset) for f in m.fields if f.name in _AXES or f.count <= 1}
    data, order = m.data if data is None else data, ">" if m.is_bigendian else "<"
    grid = _grid(data, m.height, m.width, m.point_step, m.row_step, fields, order)
    return Cloud(ros_stamp(m.header), frame_name(m.header.frame_id), grid)


def _ros_image(m: Any) -> Image:
    order = ">" if m.is_bigendian else "<"
    return _image(ros_stamp(m.header), m.header.frame_id, m.encoding, m.height, m.width, m.step, m.data, order)


def _ros_disparity(m: Any) -> Image:
    """The depth f T / d (REP 118: stereo_msgs/DisparityImage); 0 where nothing was matched."""
    image = _ros_image(m.image)
    if image.raw is None or image.encoding.upper() != "32FC1":
        raise Unusable(f"a disparity image of encoding '{image.encoding}': its unit is not known. It has to be 32FC1")
    base = float(getattr(m, "t", None) or getattr(m, "T", 0.0))  # ROS 1 has a capital
    metres = abs(float(m.f) * base)
    if not 0 < metres < np.inf:
        raise Unusable(f"a disparity image with focal length {float(m.f):g} and base {base:g}: no distances follow")
    with np.errstate(invalid="ignore", divide="ignore"):
        matched = np.isfinite(image.raw) & (image.raw > max(float(m.min_disparity), 0.0))
        depth = np.where(matched, np.float32(metres) / image.raw, np.float32(0))
    stamp, frame = image.stamp_ns or ros_stamp(m.header), image.frame or frame_name(m.header.frame_id)
    return replace(image, stamp_ns=stamp, frame=frame, encoding=DISPARITY, raw=depth)


def _ros_laser(m: Any) -> Cloud:
    ranges = np.array(m.ranges, float)
    with np.errstate(invalid="ignore"):
        # Drivers mark "nothing seen" by numbers out of range; a range_max of 0 is one that nobody filled in.
        ranges[(ranges < m.range_min) | ((ranges > m.range_max) & (m.range_max > 0))] = np.nan
    grid = _fan(m.angle_min + m.angle_increment * np.arange(len(ranges)), ranges)
    return Cloud(ros_stamp(m.header), frame_name(m.header.frame_id), grid)


def _fan(angles: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Readings of a laser scanner (radians from x towards y, metres) as the grid of a cloud; NaN: nothing seen."""
    if trouble := too_large("the turn has", len(ranges), "points", "points"):
        raise ValueError(trouble)
    grid = np.zeros((1, len(ranges)), np.dtype([("x", "f8"), ("y", "f8"), ("z", "f8")]))
    ranges = np.where(np.isfinite(ranges) & (ranges > 0), ranges, np.nan)
    grid["x"], grid["y"] = ranges * np.cos(angles), ranges * np.sin(angles)
    return grid


def _ros_calibration(m: Any) -> Calibration:
    numbers = (
        np.array(getattr(m, name, None) if hasattr(m, name) else getattr(m, name.upper()), float) for name in "kprd"
    )  # ROS 1 has capitals
    k, p, r, D = numbers
    stated = bool(m.roi.width or m.roi.height or m.roi.x_offset or m.roi.y_offset), max(m.binning_x, m.binning_y) > 1
    made = []
    # as stated first, then without the region, the binning, or both: drivers state what they do not do
    for region, binned in dict.fromkeys(
        (a and stated[0], b and stated[1]) for a in (True, False) for b in (True, False)
    ):
        # K describes the full sensor; the image may be a part of it (roi), with pixels added together (binning).
        K, P, width, height = k.reshape(3, 3).copy(), p.reshape(3, 4).copy(), m.width, m.height
        bx, by = (max(int(m.binning_x), 1), max(int(m.binning_y), 1)) if binned else (1, 1)
        for matrix in (K, P):
            if region:
                matrix[0, 2] -= m.roi.x_offset
                matrix[1, 2] -= m.roi.y_offset
            matrix[0] /= bx
            matrix[1] /= by
        if region:
            width, height = m.roi.width or m.width, m.roi.height or m.height
        lens = ros_stamp(m.header), frame_name(m.header.frame_id), width // bx, height // by, m.distortion_model, D
        made.append(Calibration(*lens, K, P, _rotation(r)))
    return replace(made[0], others=tuple(made[1:]))


def _rotation(numbers: Any) -> np.ndarray:
    """The nine numbers of a rectifying rotation; the identity if all are zero or missing: the driver did not fill them
    in."""
    R = np.array(numbers, float)
    return R.reshape(3, 3) if R.size == 9 and np.any(R) else np.eye(3)


def _ros_tf(m: Any) -> list[Transform]:
    return [
        Transform(
            ros_stamp(t.header),
            frame_name(t.header.frame_id),
            frame_name(t.child_frame_id),
            xyz(t.transform.translation),
            xyzw(t.transform.rotation),
        )
        for t in m.transforms
    ]


def _foxglove_cloud(m: Any) -> Cloud:
    fields = {f.name: (_FOXGLOVE_FIELDS.get(f.type), f.offset) for f in m.fields}
    if m.point_stride <= 0:
        raise ValueError("point_stride is 0")
    count = len(m.data) // m.point_stride
    grid = _grid(m.data, 1, count, m.point_stride, len(m.data), fields, "<")
    return Cloud(pb_stamp(m), frame_name(m.frame_id), grid, foxglove_pose(m))


def foxglove_pose(m: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Rotation and position of a measurement in its frame, if the message has a pose."""
    if not m.HasField("pose"):
        return None
    q = xyzw(m.pose.orientation)
    position = xyz(m.pose.position)
    if not plausible(position, q):
        raise ValueError("its pose has no finite and possible numbers")
    # Protobuf leaves an unset quaternion all zeros.
    return Rotation.from_quat(q).as_matrix() if np.any(q) else np.eye(3), position


def _foxglove_laser(m: Any) -> Cloud:
    ranges = np.array(m.ranges, float)
    grid = _fan(np.linspace(m.start_angle, m.end_angle, len(ranges)), ranges)
    return Cloud(pb_stamp(m), frame_name(m.frame_id), grid, foxglove_pose(m))


def _foxglove_calibration(m: Any) -> Calibration:
    K = np.array(m.K, float).reshape(3, 3) if m.K else np.zeros((3, 3))
    P = np.array(m.P, float).reshape(3, 4) if m.P else np.zeros((3, 4))
    D = np.array(m.D, float)
    R, frame = _rotation(m.R), frame_name(m.frame_id)
    return Calibration(pb_stamp(m), frame, m.width, m.height, m.distortion_model, D, K, P, R)


def _foxglove_transform(m: Any) -> Transform:
    return Transform(
        pb_stamp(m), frame_name(m.parent_frame_id), frame_name(m.child_frame_id), xyz(m.translation), xyzw(m.rotation)
    )


# 7 parameters: the fields of a cloud message
def _grid(data: Any, rows: int, columns: int, step: int, row_step: int, fields: dict, order: str) -> np.ndarray:
    if any(axis not in fields or fields[axis][0] is None for axis in _AXES):
        raise ValueError(f"the cloud has no fields x, y, z but {', '.join(fields) or 'none'}")
    whole = [n for n, (kind, offset) in fields.items() if kind is not None and offset + int(kind[1]) <= step]
    names = [*_AXES, *(n for n in whole if n and n not in _AXES)]
    formats = [order + str(fields[name][0]) for name in names]
    offsets = [fields[name][1] for name in names]
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    if rows * columns == 0:
        return np.empty((0, 0), dtype)
    if trouble := too_large("the cloud has", rows * columns, "points", "points"):
        raise ValueError(trouble)
    if rows == 1 or row_step < columns * step:
        row_step = columns * step  # some drivers leave row_step at 0
    return array_at(data, dtype, (rows, columns), strides=(row_step, step))


# 8 parameters: the fields of an image message
def _image(
    stamp_ns: int, frame: str, encoding: str, rows: int, columns: int, step: int, data: Any, order: str
) -> Image:
    kind, unit = DEPTH_ENCODINGS.get(encoding.strip().upper(), ("", 1.0))
    raw = colour = None
    if trouble := too_large("the image has", rows * columns, "pixels", "pixels"):
        raise ValueError(trouble)
    if encoding.strip().lower() in PIXELS:
        colour = colour_image(stamp_ns, frame, encoding, rows, columns, step, data)
    if kind:
        dtype = np.dtype(order + kind)
        step = max(step, columns * dtype.itemsize)
        if rows * columns == 0:
            raise ValueError("the image is empty")
        raw = array_at(data, dtype, (rows, columns), strides=(step, dtype.itemsize))
    elif not encoding:
        raise ValueError("the image names no encoding")
    return Image(stamp_ns, frame_name(frame), encoding.strip(), (rows, columns), raw, unit, colour)


CONVERTERS = {
    "stereo_msgs/msg/DisparityImage": ("image", _ros_disparity),
    "sensor_msgs/msg/PointCloud2": ("point cloud", ros_cloud),
    "sensor_msgs/msg/Image": ("image", _ros_image),
    "sensor_msgs/msg/LaserScan": ("laser scan", _ros_laser),
    "sensor_msgs/msg/CameraInfo": ("calibration", _ros_calibration),
    "tf2_msgs/msg/TFMessage": ("transforms", _ros_tf),
    "foxglove.PointCloud": ("point cloud", _foxglove_cloud),
    "foxglove.RawImage": (
        "image",
        lambda m: _image(pb_stamp(m), m.frame_id, m.encoding, m.height, m.width, m.step, m.data, "<"),
    ),
    "foxglove.LaserScan": ("laser scan", _foxglove_laser),
    "foxglove.CameraCalibration": ("calibration", _foxglove_calibration),
    "foxglove.FrameTransform": ("transforms", lambda m: [_foxglove_transform(m)]),
    "foxglove.FrameTransforms": ("transforms", lambda m: [_foxglove_transform(t) for t in m.transforms]),
}
