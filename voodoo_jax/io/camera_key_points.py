"""Key points that a network finds in the images of several cameras, where a log has no other measurements."""

from collections import Counter

import numpy as np

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.calibrations import calibration_of
from voodoo_jax.io.container import guarded
from voodoo_jax.io.decode.registry import DECODE_ERRORS, Decoder
from voodoo_jax.io.frame_sync import clean_stamps
from voodoo_jax.io.image_fit import fitted
from voodoo_jax.io.landmark_table import Gathered
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.pictures import camera_topics
from voodoo_jax.io.pose_rays import ROWS, SEEN
from voodoo_jax.io.stereo_pairs import picture_of
from voodoo_jax.io.topic import DEPTH_USES, POSE_USE
from voodoo_jax.records.messages import PAIRS, RAYS, many
from voodoo_jax.sensors.pose_net import KEY_POINTS, PoseNet, pose_files


def with_key_points(scan: Scan, settings: ReadSettings) -> Scan:
    """The scan of a log, after `read.pose_net` has looked at all images if the log has at least two calibrated colour
    cameras and no other measurements: the cameras are topics of 2D features then, of one person each. Raises
    SettingsError without the networks, LogError where the log cannot be read."""
    cameras, _ = camera_topics(scan.topics, scan.uses)
    if len(cameras) < 2 or scan.stereo or {*DEPTH_USES, RAYS, PAIRS} & set(scan.uses.values()):
        return scan
    from voodoo_jax.io.decode.image_codec import pixels  # with OpenCV

    files = pose_files(settings.pose_net)
    nets = {name: PoseNet(files) for name in cameras}
    decoder, seen, blind = Decoder(), Counter[str](), Counter[str]()
    found: dict[str, list[tuple[int, np.ndarray, np.ndarray]]] = {name: [] for name in cameras}
    wanted = lambda s, c: c.topic in nets and scan.kind(s, c) == scan.topics[c.topic].kind  # noqa: E731
    for schema, channel, message in guarded(scan.log, wanted):
        name, number = channel.topic, seen[channel.topic]
        seen[name] += 1
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
