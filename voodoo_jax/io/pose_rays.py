"""Key points of a person that a network finds in a log's colour images: as rays, while it is read, for frames come with
their images; and as 2D features of several cameras, where a log has no other measurements."""

from collections import Counter

import numpy as np

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.calibrations import calibration_of, fitted
from voodoo_jax.io.decode.image_codec import pixels
from voodoo_jax.io.decode.registry import DECODE_ERRORS, Decoder
from voodoo_jax.io.frame_sync import clean_stamps
from voodoo_jax.io.landmark_table import Gathered
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.point_labels import Parts
from voodoo_jax.io.stereo_pairs import picture_of
from voodoo_jax.io.topic import DEPTH_USES, POSE_USE
from voodoo_jax.io.topic_roles import camera_topics
from voodoo_jax.records.messages import PAIRS, RAYS, many
from voodoo_jax.records.recording import Picture, Rays, joined_rays
from voodoo_jax.sensors.pose_net import KEY_POINTS, PoseNet, pose_files

# joints that the network puts where their centres are. Its hips are 3 cm too low, and those, nose, ears and feet gave
# 3.9 and 4.2 cm instead of 3.6 on three of nine rendered stereo logs (without any key points 3.8)
NAMES = tuple(
    f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist", "knee", "ankle") for side in ("left", "right")
)
SEEN = 0.8  # least score; on these logs 0.5, MediaPipe's limit for what it draws, gave 3.60 cm, 0.8 3.55, 0.9 3.54
ROWS = np.array([KEY_POINTS.index(n) for n in NAMES])


def with_key_points(scan: Scan, settings: ReadSettings) -> Scan:
    """The scan of a log, after `read.pose_net` has looked at all images if the log has at least two calibrated colour
    cameras and no other measurements: the cameras are topics of 2D features then, of one person each. Raises
    SettingsError without the networks, LogError where the log cannot be read."""
    cameras, _ = camera_topics(scan.topics, scan.uses)
    if len(cameras) < 2 or scan.stereo or {*DEPTH_USES, RAYS, PAIRS} & set(scan.uses.values()):
        return scan
    files = pose_files(settings.pose_net)
    nets = {name: PoseNet(files) for name in cameras}
    decoder, blind = Decoder(), Counter[str]()
    found: dict[str, list[tuple[int, np.ndarray, np.ndarray]]] = {name: [] for name in cameras}
    for name, number, (schema, channel, message) in scan.numbered(nets):
        try:
            picture = picture_of(decoder.message(schema, channel, message.data)) if schema is not None else None
            points = None if picture is None else nets[name].find(image := pixels(picture))
        except DECODE_ERRORS:
            points = None
        scan.log.clock.restart()  # a network takes its time
        if points is None:
            blind[name] += 1
            continue
        if not found[name]:
            given = calibration_of(scan.topics, name)
            assert given is not None  # camera_topics asks for it
            scan.topics[name].given = fitted(given, image.shape[:2])[0]
        sure = ROWS[points.scores[ROWS] >= SEEN]
        found[name].append((number, sure, np.column_stack([points.pixels, points.scores])[sure]))
    scan.notes += [f"'{name}': {many(n)} in which read.pose_net finds no person." for name, n in blind.items()]
    for name in cameras:
        topic, looks = scan.topics[name], found[name]
        stamps = clean_stamps(name, topic.stamps, topic.log_times, [])
        rows = np.concatenate([np.zeros((0, 3)), *(values for _, _, values in looks)])
        names = tuple(KEY_POINTS[k] for _, points, _ in looks for k in points)
        times = np.concatenate([np.zeros(0, np.int64), *(np.full(len(k), stamps[n]) for n, k, _ in looks)])
        frames = (topic.sample.frame,) * len(rows)
        topic.gathered = Gathered(stamps, names, frames, times, rows[:, :2], rows[:, 2])
        scan.uses[name] = RAYS if looks else POSE_USE
    return scan


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
