"""Key points of a person in a log's colour images as rays, while it is read: frames come with their images."""

from collections import Counter

import numpy as np

from voodoo_jax.io.decode.registry import DECODE_ERRORS
from voodoo_jax.io.point_labels import Parts
from voodoo_jax.records.recording import Picture, Rays, joined_rays
from voodoo_jax.sensors.pose_net import KEY_POINTS, PoseNet, pose_files

# joints that the network puts where their centres are. Its hips are 3 cm too low, and those, nose, ears and feet gave
# 3.9 and 4.2 cm instead of 3.6 on three of nine rendered stereo logs (without any key points 3.8)
NAMES = tuple(
    f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist", "knee", "ankle") for side in ("left", "right")
)
SEEN = 0.8  # least score; on these logs 0.5, MediaPipe's limit for what it draws, gave 3.60 cm, 0.8 3.55, 0.9 3.54
ROWS = np.array([KEY_POINTS.index(n) for n in NAMES])


class PoseRays:
    """Makes rays from the images of a log's frames, in order of time.

    A network for each camera follows the person from image to image; the same images give the same rays.
    """

    def __init__(self, place: str, weights: Parts, counted: Counter[tuple[str, str]]):
        """`place` is read.pose_net; `counted` takes what happens to images, by topic. Raises SettingsError where the
        networks are missing."""
        self._files, self._weights, self._counted = pose_files(place), weights, counted
        self._nets: dict[str, PoseNet] = {}

    def rays(self, pictures: tuple[Picture, ...]) -> Rays:
        """Rays of one frame; names as in NAMES, weights are the network's scores times those of read.weights."""
        found = [rays for picture in pictures if (rays := self._of_one(picture)) is not None]
        return joined_rays(found)

    def _of_one(self, picture: Picture) -> Rays | None:
        """Of a camera; of a rectified pair of them the left one."""
        try:
            image = picture.unpack()[0]
        except DECODE_ERRORS:
            self._counted[picture.topic, "cannot be decoded, and give no key points"] += 1
            return None
        if picture.topic not in self._nets:
            self._nets[picture.topic] = PoseNet(self._files)
        found = self._nets[picture.topic].find(image)
        if found is None:
            self._counted[picture.topic, "in which read.pose_net finds no person"] += 1
            return None
        rows = ROWS[found.scores[ROWS] >= SEEN]
        K, pose = picture.K, picture.T_fixed_camera
        flat = (found.pixels[rows] - K[:2, 2]) / [K[0, 0], K[1, 1]]
        directions = np.column_stack([flat, np.ones(len(rows))]) @ pose[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        weights = found.scores[rows] * self._weights.weight(picture.topic)
        made = np.tile(pose[:3, 3], (len(rows), 1)), directions, weights
        return Rays(tuple(KEY_POINTS[k] for k in rows), *(part.astype(np.float32) for part in made))
