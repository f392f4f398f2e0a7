"""Messages with colour images, and pictures of a scene of upright planes from any camera."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf import CompressedImage_pb2, RawImage_pb2

from tests.support.logs import START, T, header
from voodoo_jax.geometry import lens


def ros_compressed(stamp_ns: int, frame: str, image: np.ndarray, kind: str = ".jpg", format: str = "jpeg") -> Any:
    """image [row, column, 3] uint8: blue, green, red."""
    data = np.asarray(cv2.imencode(kind, image)[1]).ravel()
    return T["sensor_msgs/msg/CompressedImage"](header(stamp_ns, frame), format, data)


def ros_raw(stamp_ns: int, frame: str, encoding: str, packed: np.ndarray, padding: int = 0) -> Any:
    """packed [row, column, byte] as the encoding has it."""
    rows, columns = packed.shape[:2]
    data = np.full((rows, packed[0].size + padding), 0xAB, np.uint8)
    data[:, : packed[0].size] = packed.reshape(rows, -1)
    return T["sensor_msgs/msg/Image"](
        header(stamp_ns, frame), rows, columns, encoding, 0, data.shape[1], data.ravel()
    )  # fmt: skip


def foxglove_compressed(stamp_ns: int, frame: str, image: np.ndarray, kind: str = ".png", format: str = "png") -> Any:
    data = np.asarray(cv2.imencode(kind, image)[1]).tobytes()
    m = CompressedImage_pb2.CompressedImage(frame_id=frame, format=format, data=data)
    m.timestamp.FromNanoseconds(stamp_ns)
    return m


def foxglove_raw(stamp_ns: int, frame: str, encoding: str, packed: np.ndarray) -> Any:
    rows, columns = packed.shape[:2]
    m = RawImage_pb2.RawImage(frame_id=frame, width=columns, height=rows, encoding=encoding, data=packed.tobytes())
    m.step = packed[0].size
    m.timestamp.FromNanoseconds(stamp_ns)
    return m


def ros_info(
    frame: str, k: np.ndarray, size: tuple[int, int], d: tuple[float, ...] = (), p03: float = 0.0, r: Any = None, p=None
) -> Any:
    """CameraInfo; p03: P[0, 3], minus focal length times baseline; size: rows, columns."""
    p = np.hstack([k if p is None else p, [[p03], [0.0], [0.0]]])
    roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    r = np.eye(3) if r is None else r
    return T["sensor_msgs/msg/CameraInfo"](
        header(START, frame), *size, "plumb_bob", np.array(d, float), k.ravel(), r.ravel(), p.ravel(), 0, 0, roi
    )  # fmt: skip


@dataclass(frozen=True)
class Board:
    """A textured board across the z axis of the left camera: at z, from the low to the high corner in x and y."""

    z: float
    low: tuple[float, float] = (-9.0, -9.0)
    high: tuple[float, float] = (9.0, 9.0)


def picture(
    boards: list[Board],
    k: np.ndarray,
    size: tuple[int, int],
    place: Any = (0.0, 0.0, 0.0),
    turn: np.ndarray | None = None,
    d: tuple[float, ...] = (),
    noise: float = 3.0,
) -> np.ndarray:
    """What a camera at `place` (metres), turned by `turn` (camera to world), sees of the boards, [row, column, 3]."""
    rng = np.random.default_rng(7)
    rows, columns = size
    rays = lens.pixel_rays(k, np.array(d, float), "plumb_bob", columns, rows)
    rays = np.concatenate([rays, np.ones((rows, columns, 1))], -1) @ (np.eye(3) if turn is None else turn).T
    image = np.zeros((rows, columns), np.float32)
    for n, board in enumerate(sorted(boards, key=lambda b: -b.z)):
        texture = cv2.GaussianBlur(rng.uniform(0, 255, (900, 900)).astype(np.float32), (0, 0), 1.5)
        texture = (texture - texture.mean()) * 3 + 100 + 20 * n
        s = (board.z - place[2]) / rays[..., 2]
        x, y = (rays[..., i] * s + place[i] for i in (0, 1))
        # 1 cm per pixel of the texture
        seen = cv2.remap(
            texture, ((x % 9) * 100).astype(np.float32), ((y % 9) * 100).astype(np.float32), cv2.INTER_LINEAR
        )
        inside = (x >= board.low[0]) & (x <= board.high[0]) & (y >= board.low[1]) & (y <= board.high[1])
        image = np.where(inside, seen, image)
    image = image + np.random.default_rng(int(1e3 * place[0])).normal(0, noise, image.shape)
    return np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, -1)
