"""Crop offsets of images whose calibration is for the whole image, estimated from the floor. Host side."""

import numpy as np

from voodoo_jax.detect.delays import FAR
from voodoo_jax.detect.scene import find_scene
from voodoo_jax.detect.units import AT_ZERO, SPREAD
from voodoo_jax.io.calibrations import CROPPED
from voodoo_jax.io.opened_log import LogReader
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.tracks import RIGHT

LEVEL, TILTED = 1.0, 2.0  # degrees: a floor by transforms as exact as they are, and one that is not; by hand


def with_crops(reader: LogReader) -> LogReader:
    """The reader, with the principal point of cropped images such that their floor is level. If no floor is visible, it
    adds a note and the probability that positions are right."""
    for topic in reader.sensors:
        (across, down), focal = reader.leeway(topic)
        if not (across or down):
            continue
        samples = reader.sampled(topic, SPREAD, spread=True)
        # of a stereo pair nothing is known before it is matched
        place = (_level(reader, topic, samples, down) if samples else None) if down else 0.0
        aside = float(np.hypot(across, down if place is None else 0.0)) / focal
        unit = reader.scales.get(topic, reader.unit(topic)) / reader.unit(topic)
        far = aside * (unit * float(np.median(np.concatenate([s.distances for s in samples]))) if samples else FAR)
        sure = 0.5 + 0.5 * min(1.0, RIGHT / max(far, 1e-9))  # about the middle or not: nothing tells
        reader = reader.with_crop(topic, (0.0, place or 0.0), sure)
        if far > RIGHT:
            reader.say(
                f"It is unknown where '{topic}' was cropped: joints may be up to {100 * far:.0f} cm off, and their "
                "confidence is lower. Set read.camera."
            )
    for topic in reader.cameras:
        if any(reader.leeway(topic)[0]):
            reader.say(f"The colour images of '{topic}' are of another size than their calibration, and {CROPPED}.")
    return reader


def _level(reader: LogReader, topic: str, samples: list, down: float) -> float | None:
    """Pixels by which the principal point must be below the centre for a level floor; None without a floor."""
    if reader.up[2] <= 0.99:  # nothing says how the camera is held
        return None
    places = np.array([-down, 0.0, down])
    floors = [_floor(reader.with_crop(topic, (0.0, float(place))), topic, samples) for place in places]
    found = [one for one in floors if one is not None]
    if len(found) < len(places):
        return None
    normals = np.array([normal for normal, _ in found])
    # the floor turns about one level line: how far, signed, by the way in which it leans between first and last
    lean = normals[2, :2] - normals[0, :2]
    tilt = np.degrees(np.arcsin(np.clip(normals[:, :2] @ (lean / max(float(np.linalg.norm(lean)), 1e-9)), -1, 1)))
    if abs(tilt[1]) < LEVEL and abs(found[1][1]) < AT_ZERO:
        return 0.0
    if abs(tilt[1]) < TILTED or tilt[0] > LEVEL or tilt[2] < -LEVEL:
        return None
    place = float(np.interp(0.0, tilt, places))
    there = _floor(reader.with_crop(topic, (0.0, place)), topic, samples)
    if there is None or there[0][2] < np.cos(np.radians(LEVEL)) or abs(there[1]) > AT_ZERO:
        return None
    return place


def _floor(reader: LogReader, topic: str, samples: list) -> tuple[np.ndarray, float] | None:
    """Normal of the floor and its height in the fixed frame, metres; None if it is not visible."""
    frames: list[Frame] = [f for sample in samples if (f := reader.frame_of(topic, sample)) is not None]
    scene = find_scene(frames, reader.up, True) if frames else None
    return (scene.floor.normal, float(scene.floor.offset)) if scene is not None and scene.floor_seen else None
