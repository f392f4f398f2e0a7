"""Skin regions of a log's colour images as rays, by frame, in a separate pass over these images."""

from collections import Counter

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy.spatial import KDTree

from voodoo_jax.geometry import lens
from voodoo_jax.io.calibrations import fitted, lens_of
from voodoo_jax.io.decode.image_codec import pixels
from voodoo_jax.io.decode.registry import DECODE_ERRORS, Decoder
from voodoo_jax.io.frame_sync import clean_stamps, join_one
from voodoo_jax.io.landmark_plan import FeaturePlan
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.point_labels import Parts
from voodoo_jax.io.stereo_pairs import picture_of
from voodoo_jax.io.topic_roles import UNSEARCHED
from voodoo_jax.records.messages import many
from voodoo_jax.records.recording import Rays

SKIN = "skin"  # name of the feature
_STILL = 1.5  # pixels of an image 640 wide: a standing head sways more within a few seconds
_OFTEN, _SECONDS = 0.8, 3.0  # furniture is there in this share of the images; shorter logs do not tell


def plan_skin(scan: Scan, fixed: str, times: Int64[np.ndarray, " frame"], weights: Parts) -> FeaturePlan:
    """Assigns the skin regions of each camera's images to the frames (`times`, increasing, nanoseconds), the image
    nearest in time to each.

    Regions that keep their place in nearly all of a log, while others move, are furniture and left out.
    """
    cameras, plan = scan.skin, FeaturePlan()
    if not cameras:
        plan.notes.append("read.skin has no effect: the log has no calibrated colour images.")
        return plan
    counted: Counter[tuple[str, str]] = Counter()
    wanted = {}  # (topic, number of the message) -> frame
    stamps = {n: clean_stamps(n, scan.topics[n].stamps, scan.topics[n].log_times, []) for n in cameras}
    for name in cameras:
        if scan.tree.connected(scan.topics[name].sample.frame, fixed):
            wanted |= {(name, message): frame for frame, message in join_one(times, stamps[name])}
        else:
            plan.notes.append(UNSEARCHED.format(name, f"no transform between its camera and '{fixed}'"))
    regions = _find(scan, set(cameras), set(wanted), counted)
    made: dict[int, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for name, c in cameras.items():
        keys = [key for key in regions if key[0] == name]
        still = _still([regions[key][0] for key in keys], [regions[key][1] for key in keys],
                       np.array([stamps[name][number] for _, number in keys], np.int64))  # fmt: skip
        if furniture := sum(bool(s.any()) for s in still):
            counted[name, "with skin-coloured regions that never move, which are left out"] = furniture
        for (_, number), gone in zip(keys, still):
            shape, pixels = regions[name, number]
            try:
                own = fitted(c, shape)[0]
            except ValueError as problem:
                counted[name, f"without skin, because {problem}"] += 1
                continue
            flat = lens.undistort(pixels[~gone], *lens_of(name, own), c.model)
            flat = flat[np.isfinite(flat).all(1)]
            pose = scan.tree.lookup(fixed, scan.topics[name].sample.frame, int(stamps[name][number]))
            if pose is None:
                counted[name, "without a transform at the stamp, left out of skin detection"] += 1
            elif len(flat):
                directions = np.column_stack([flat, np.ones(len(flat))]) @ pose[0].T
                directions /= np.linalg.norm(directions, axis=1, keepdims=True)
                origins, weight = np.tile(pose[1], (len(flat), 1)), np.full(len(flat), weights.weight(name))
                made.setdefault(wanted[name, number], []).append((origins, directions, weight))
    weighted = weights.weighted(tuple(cameras))
    for frame, parts in made.items():
        origins, directions, weight = (np.concatenate(p).astype(np.float32) for p in zip(*parts))
        plan.rays[frame] = Rays((SKIN,) * len(origins), origins, directions, weight if weighted else None)
    plan.topics = tuple(sorted({name for name, _ in regions}))
    plan.notes += [f"'{topic}': {many(n)} {what}." for (topic, what), n in counted.items()]
    return plan


def _find(scan: Scan, names: set[str], wanted: set[tuple[str, int]], counted: Counter) -> dict:
    """(rows, columns) of the image and pixels [region, 2], by (topic, number of the message)."""
    from voodoo_jax.sensors.skin_colour import SkinFinder

    finders = {name: SkinFinder() for name in names}
    decoder, found = Decoder(), {}
    for topic, number, (schema, channel, message) in scan.numbered(names):
        key = topic, number
        if key not in wanted or schema is None:
            continue
        try:
            picture = picture_of(decoder.message(schema, channel, message.data))
            image = None if picture is None else pixels(picture)
        except DECODE_ERRORS:
            image = None
        if image is None:
            counted[channel.topic, "cannot be decoded, left out of skin detection"] += 1
            continue
        found[key] = (image.shape[0], image.shape[1]), finders[channel.topic].find(image).centres
    return found


def _still(
    shapes: list[tuple[int, int]], pixels: list[Float[np.ndarray, "_ 2"]], stamps: Int64[np.ndarray, " image"]
) -> list[Bool[np.ndarray, " _"]]:
    """Which regions of each image keep their place in nearly all images; none if all do, or the log is short."""
    gone = [np.zeros(len(p), bool) for p in pixels]
    if not len(stamps) or np.ptp(stamps) < _SECONDS * 1e9 or not any(len(p) for p in pixels):
        return gone
    alike = [p * 640 / shape[1] for p, shape in zip(pixels, shapes)]
    every = np.concatenate(alike)
    some = alike[:: max(1, len(alike) // 200)]
    there = np.zeros(len(every))
    for p in some:
        if len(p):
            there += KDTree(p).query(every)[0] <= _STILL
    gone = np.split(there >= _OFTEN * len(some), np.cumsum([len(p) for p in pixels])[:-1])
    moving = sum(int((~g).sum()) for g in gone)
    return gone if moving >= 0.5 * len(gone) else [np.zeros(len(g), bool) for g in gone]
