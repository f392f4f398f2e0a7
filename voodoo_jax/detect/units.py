"""Detects units of distances that differ from those of the encoding, by floor, body and range. Host side, NumPy.

Depth of 16 bits may be in steps of 0.25 mm or 0.1 mm, 32-bit depth and clouds in millimetres. Plausible units are kept;
a single certain one is applied, with a note; otherwise an error names the option.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.find_gravity import LEAST, LIKELIER, LOW, likely_body, upright
from voodoo_jax.detect.scene import find_scene
from voodoo_jax.io.container import LogError
from voodoo_jax.io.opened_log import FEW_POINTS, LogReader, Sample
from voodoo_jax.records.recording import Frame

FIRST, SPREAD = 3, 7  # messages that are looked at at once, and of the whole log where there is doubt; by hand
USUAL = 0.3, 5.0  # metres: usual median distances; measured: 1.5 to 3.6 in indoor recordings
HEIGHT = 0.2, 4.0  # metres above the floor: where a sensor stands or hangs; by hand
POSSIBLE = 0.4, 15.0  # metres: what is nearer or farther (median) no depth camera measures; by hand
OPEN_AIR = 60.0  # metres: the same of laser scanners and other clouds; measured: 6 to 19 of cars' in streets
# times as large or small; 0.25 mm (L515), 0.1 mm (D405), mm for m and cm for m; by hand
FACTORS = (0.001, 0.01, 0.1, 0.25, 0.5, 2.0, 10.0, 100.0, 1000.0)
AT_ZERO, NOT_ZERO = 0.1, 0.4  # metres: a floor is, or is not, at the height 0 of the fixed frame; by hand


def with_units(reader: LogReader, build: Build, settings: DetectSettings) -> LogReader:
    """The reader, with another scale for topics in another unit. Raises LogError if the unit is unusual and
    ambiguous."""
    scales: dict[str, float] = {}
    for topic in reader.sensors:
        if topic in reader.scales or not _doubted(reader, topic, reader.sampled(topic, FIRST)):
            continue
        samples = reader.sampled(topic, SPREAD, spread=True)
        if (factor := _factor(reader, topic, samples, build, settings)) != 1:
            scales[topic] = reader.unit(topic) * factor
            reader.say(
                f"'{topic}': a unit of its distances is {scales[topic]:g} m, not {reader.unit(topic):g} m as usual: "
                "then floor, body and range fit. To override, set read.scale."
            )
    return reader.with_scales(scales) if scales else reader


def _distance(samples: Sequence[Sample]) -> float:
    """Median distance in the usual unit, metres; NaN without measurements."""
    every = np.concatenate([np.zeros(0), *(sample.distances for sample in samples)])
    return float(np.median(every)) if len(every) else float("nan")


def _doubted(reader: LogReader, topic: str, samples: Sequence[Sample]) -> bool:
    """Whether the first messages show unusual distances, or a floor at a wrong height."""
    if not samples:
        return False
    if not USUAL[0] <= _distance(samples) <= USUAL[1]:
        return True
    frame = reader.coarse(FEW_POINTS).frame_of(topic, samples[0])
    if frame is None or not len(frame.points):
        return False
    if reader.up[2] <= 0.99:  # without transforms the height of the floor is unknown
        return False
    scene = find_scene([frame], reader.up)
    return scene.floor_seen and abs(scene.floor.offset) > NOT_ZERO


def _factor(reader: LogReader, topic: str, samples: Sequence[Sample], build: Build, settings: DetectSettings) -> float:
    """Factor on the usual unit."""
    distance = _distance(samples)
    low, high = POSSIBLE if reader.is_image(topic) else (POSSIBLE[0], OPEN_AIR)
    possible = [f for f in (1.0, *FACTORS) if low <= f * distance <= high]
    likely, at_zero = {}, {}
    for factor in possible:
        scaled = reader.with_scales({topic: reader.unit(topic) * factor})
        frames = [f for sample in samples if (f := scaled.frame_of(topic, sample)) is not None and len(f.points)]
        low = replace(settings, min_height=min(settings.min_height, LOW)) if factor == 1 else settings
        likely[factor], at_zero[factor] = _fits(frames, reader, build, low)
        if factor == 1 and likely[1.0] > LEAST and not abs(at_zero[1.0]) > NOT_ZERO:
            return 1.0
    ranked = sorted(likely, key=lambda f: -likely[f])
    # the transforms may say how high the sensor is above the floor
    zero = [f for f, offset in at_zero.items() if abs(offset) < AT_ZERO]
    if ranked and likely[ranked[0]] > LEAST and all(likely[ranked[0]] > LIKELIER * likely[f] for f in ranked[1:]):
        # a child is not an adult in other units
        return ranked[0] if likely.get(1.0, 0.0) == 0 or ranked[0] in zero else 1.0
    if ranked and likely.get(1.0, 0.0) >= likely[ranked[0]] > 0:
        return 1.0
    if len(zero) == 1 and (zero[0] == 1 or not abs(at_zero.get(1.0, np.inf)) < NOT_ZERO):
        return zero[0]
    if 1.0 in possible:
        return 1.0
    if len(possible) == 1:
        return possible[0]
    near = ", ".join(f"'{topic}={reader.unit(topic) * f:g}'" for f in possible[:2]) or f"'{topic}=0.001'"
    raise LogError(
        f"'{reader.path}': the distances of '{topic}' are {distance:.3g} m (median) if its unit is "
        f"{reader.unit(topic):g} m, and the unit is ambiguous. Set read.scale: metres per unit, such as {near}."
    )


def _fits(frames: list[Frame], reader: LogReader, build: Build, settings: DetectSettings) -> tuple[float, float]:
    """Body likelihood of an object on the floor, and the height of the floor in the fixed frame (NaN without one)."""
    if not frames:
        return 0.0, float("nan")
    sure = bool(reader.up[2] > 0.99)
    scene = find_scene(frames, reader.up, sure)
    offset = float(scene.floor.offset) if scene.floor_seen and sure else float("nan")
    up = reader.up if reader.up_is_given else upright(frames, scene, reader.up, sure, build, settings)
    if up is not reader.up:
        scene = find_scene(frames, up, False)
    known = scene.floor_seen or not scene.floor_open  # else any height of body would be on it
    if scene.floor_seen and not sure:
        known = HEIGHT[0] <= float(scene.floor.height(frames[0].origins)[0]) <= HEIGHT[1]
    return (likely_body(scene, frames, build, settings) if known else 0.0), offset
