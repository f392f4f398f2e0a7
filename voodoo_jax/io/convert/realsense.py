"""Differences of bags of the RealSense viewer and SDK: names of topics, and the unit of depth.

Image and calibration of a stream are `/device_0/sensor_0/Depth_0/image/data` and `.../info/camera_info`, the unit of
depth counts is the option Depth_Units (librealsense, src/media/ros).
"""

import re
from typing import Any

import numpy as np

IMAGE = re.compile(r"^(/device_\d+)/sensor_\d+/(\w+?)_(\d+)/(?:image/data|info/(camera_info))$")
UNITS = re.compile(r"^(/device_\d+)/sensor_\d+/option/Depth[_ ]Units/value$")
MILLIMETRE = 0.001
CLOSE = 1e-6  # metres: units that differ by less are one


def plain_topic(topic: str) -> str:
    """The common topic of an image and its calibration; others are unchanged."""
    match = IMAGE.match(topic)
    if match is None:
        return topic
    device, stream, number, info = match.groups()
    name = stream.lower() + (f"_{number}" if number != "0" else "")
    return f"{device}/{name}/{'camera_info' if info else 'image'}"


def depth_units(reader: Any) -> dict[str, float]:
    """Metres per depth count, by device, if it is not a millimetre."""
    found: dict[str, float] = {}
    connections = [c for c in reader.connections if UNITS.match(c.topic)]
    for connection, _, raw in reader.messages(connections=connections) if connections else ():
        device = UNITS.match(connection.topic)[1]  # type: ignore[index]
        unit = float(reader.deserialize(raw, connection.msgtype).data)
        if unit > 0 and abs(unit - MILLIMETRE) > CLOSE:
            found.setdefault(device, unit)
    return found


def unit_of(topic: str, kind: str, units: dict[str, float]) -> float | None:
    """Metres per count of a topic's images; None: they are millimetres, or no depth images."""
    match = IMAGE.match(topic)
    if match is None or not kind.endswith("/Image") or match[2].lower() != "depth":
        return None
    return units.get(match[1])


def in_metres(store: Any, data: bytes, kind: str, unit: float) -> bytes:
    """Converts a message of 16-bit counts (CDR) to metres, 32 bits."""
    image = store.deserialize_cdr(data, kind)
    order = ">" if image.is_bigendian else "<"
    rows = np.asarray(image.data).reshape(image.height, image.step)[:, : 2 * image.width]
    metres = np.ascontiguousarray(rows).view(f"{order}u2") * np.float64(unit)
    values = {name: getattr(image, name) for name in ("header", "height", "width")}
    made = store.types[kind](
        **values,
        encoding="32FC1",
        is_bigendian=0,
        step=4 * image.width,
        data=metres.astype("<f4").view(np.uint8).ravel(),
    )
    return bytes(store.serialize_cdr(made, kind))
