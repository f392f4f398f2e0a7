"""Colour images of a log for trackers that use them: selection of topics, and decoding.

The left and right images of stereo pairs come rectified, others with their lens undone. Nothing is decoded before a
tracker asks for it.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Float, Int64

from voodoo_jax.geometry import lens
from voodoo_jax.io.calibrations import fitted, lens_of
from voodoo_jax.io.container import Item
from voodoo_jax.io.decode.image_codec import pixels
from voodoo_jax.io.decode.registry import DECODE_ERRORS, Decoder
from voodoo_jax.io.frame_sync import clean_stamps, join_one
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.stereo_pairs import make_rig, picture_of
from voodoo_jax.io.topic_roles import UNSEEN, camera_topics
from voodoo_jax.records.messages import Calibration, Colour, Image
from voodoo_jax.records.recording import Picture

if TYPE_CHECKING:
    from voodoo_jax.sensors.stereo_rig import Rig


@dataclass(frozen=True)
class PicturePlan:
    """Frames of the messages of single cameras; stereo pairs come with their clouds."""

    cameras: dict[str, Calibration]  # by topic
    frame_of: dict[tuple[str, int], int]  # (topic, number of the message) -> frame
    notes: tuple[str, ...] = ()


def plan_pictures(scan: Scan, fixed: str, times: Int64[np.ndarray, " frame"]) -> PicturePlan:
    """The image of each single colour camera that is nearest in time to each frame (`times`, nanoseconds)."""
    cameras, notes = camera_topics(scan.topics, scan.uses)
    if scan.stereo:
        return PicturePlan({}, {}, tuple(notes))  # pairs have depth of their own
    frame_of = {}
    for name in list(cameras):
        if not scan.tree.connected(scan.topics[name].sample.frame, fixed):
            notes.append(UNSEEN.format(name, f"no transform between its camera and '{fixed}'"))
            del cameras[name]
            continue
        stamps = clean_stamps(name, scan.topics[name].stamps, scan.topics[name].log_times, [])
        frame_of |= {(name, message): frame for frame, message in join_one(times, stamps)}
    return PicturePlan(cameras, frame_of, tuple(notes))


def pose_matrix(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, translation
    return out


class PictureReader:
    """Makes Pictures of messages while a log is read."""

    def __init__(self, scan: Scan, fixed: str, cameras: dict[str, Calibration]):
        self._scan, self._fixed, self._cameras, self._decoder = scan, fixed, cameras, Decoder()
        self._rigs: dict[tuple, Any] = {}

    def _colour(self, item: Item) -> Colour:
        schema, channel, message = item
        picture = None if schema is None else picture_of(self._decoder.message(schema, channel, message.data))
        if picture is None:
            raise ValueError("not a colour image")
        return picture

    def single(self, item: Item, stamp_ns: int) -> Picture | None:
        """The image of one camera; None without a transform. Raises one of DECODE_ERRORS for broken messages."""
        topic, image = item[1].topic, self._colour(item)
        pose = self._scan.tree.lookup(self._fixed, image.frame, stamp_ns)
        if pose is None:
            return None
        c = fitted(self._cameras[topic], _shape(image))[0]
        K, D = lens_of(topic, c)
        unpack = partial(_single, image, tuple(K.ravel().tolist()), tuple(D.tolist()), c.model)
        return Picture(topic, stamp_ns, K, pose_matrix(*pose), unpack)

    def pair(self, left: Item, right: Item, stereo_pair: Any, stamp_ns: int) -> Picture | None:
        """A rectified pair; None without a transform. Raises one of DECODE_ERRORS for broken messages."""
        topic, images = left[1].topic, (self._colour(left), self._colour(right))
        pose = self._scan.tree.lookup(self._fixed, images[0].frame, stamp_ns)
        if pose is None:
            return None
        key = topic, _shape(images[0])
        if key not in self._rigs:
            self._rigs[key] = make_rig(self._scan.topics, self._scan.tree, stereo_pair, key[1])
        rig: Rig = self._rigs[key]
        K = np.array([[rig.focal, 0.0, rig.centre[0]], [0.0, rig.focal, rig.centre[1]], [0.0, 0.0, 1.0]])
        pose = pose[0] @ rig.left_R_rectified, pose[1]
        return Picture(topic, stamp_ns, K, pose_matrix(*pose), partial(_both, images, rig), rig.baseline, rig.shift)


def shape_of(sample: Any) -> tuple[int, int] | None:
    """Rows and columns of a depth or colour image; None if it is not an image, or cannot be decoded."""
    colour = picture_of(sample)
    if colour is None:
        return sample.shape if isinstance(sample, Image) else None
    try:
        return _shape(colour)
    except DECODE_ERRORS:
        return None


def _shape(image: Colour) -> tuple[int, int]:
    """Rows and columns; of a packed image its header's."""
    if image.step:
        return image.shape
    return pixels(image).shape[:2] if image.shape == (0, 0) else image.shape


def _single(image: Colour, K: tuple[float, ...], D: tuple[float, ...], model: str) -> tuple[np.ndarray, ...]:
    found = pixels(image)
    if any(D):
        found = cv2.remap(found, *_undone(K, D, model, found.shape[:2]), cv2.INTER_LINEAR)
    return (np.asarray(found, np.uint8),)


@cache
def _undone(K: tuple[float, ...], D: tuple[float, ...], model: str, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Where each pixel without lens lies in the raw image."""
    k, (rows, columns) = np.array(K).reshape(3, 3), shape
    v, u = np.mgrid[:rows, :columns].astype(float)
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1]], -1)
    d = np.pad(np.array(D), (0, max(0, 4 - len(D))))
    at = np.concatenate([lens.distort(rays, d, model), np.ones((*shape, 1))], -1) @ k.T
    return at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)


def _both(images: tuple[Colour, Colour], rig: "Rig") -> tuple[np.ndarray, ...]:
    out = []
    for image, mapping in zip(images, rig.maps):
        found = pixels(image)
        if mapping is not None:
            found = cv2.remap(found, mapping[..., 0], mapping[..., 1], cv2.INTER_LINEAR)
        out.append(np.asarray(found, np.uint8))
    return tuple(out)
