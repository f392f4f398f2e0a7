"""A log opened for tracking: what it says of units and clocks is compared with what it shows; depth cameras that smear
edges are detected by their first images. Host side."""

from dataclasses import replace

import numpy as np

from voodoo_jax.config.options import DetectSettings, ReadSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.crops import with_crops
from voodoo_jax.detect.delays import late_transforms, offsets
from voodoo_jax.detect.misplaced import with_sensors_in_place
from voodoo_jax.detect.units import FIRST, with_units
from voodoo_jax.geometry.depth_edges import SMEARED, between_edges
from voodoo_jax.io.container import LogFile, Place
from voodoo_jax.io.convert.sources import as_mcap
from voodoo_jax.io.log_reader import LogReader, open_log, read_whole
from voodoo_jax.records.messages import Image
from voodoo_jax.records.recording import Recording

PERSON = Build(1.70, 0.44)  # where nobody says who is looked for: the size of the body file `human`, measured


def without_smeared_edges(reader: LogReader) -> LogReader:
    """The reader, without points at smeared depth edges, and with a note."""
    found = frozenset(topic for topic in reader.sensors if _smeared(reader, topic))
    for topic in sorted(found):
        reader.say(
            f"Depth edges in '{topic}' are smeared, as by a filter of its camera: points between near and far "
            "objects are left out."
        )
    return reader.without_sheets(found) if found else reader


def _smeared(reader: LogReader, topic: str) -> bool:
    if not reader.is_image(topic):
        return False
    images = [content for s in reader.sampled(topic, FIRST) if isinstance(content := s.content, Image)]
    shares = [between_edges(z) for image in images if (z := reader.depth(topic, image)) is not None]
    return bool(shares) and float(np.median(shares)) > SMEARED


def open_checked(
    path: Place | LogFile,
    settings: ReadSettings | None = None,
    build: Build = PERSON,
    detect: DetectSettings | None = None,
) -> LogReader:
    """A log as `io.log_reader.open_log` gives it, its units, crops and the places of its sensors checked by what its
    messages show, without what lies in smeared edges.

    **Arguments:** `build` how large the body is that is looked for. Raises as `open_log`, and LogError where units are
    in doubt.
    """
    settings, detect = settings or ReadSettings(), detect or DetectSettings()
    reader, late = _checked(path, settings, build, detect), {}
    looks = {
        "the room, which is at rest": lambda: late_transforms(reader),
        "what it and another sensor see move": lambda: offsets(reader, build, detect),
    }
    for how, look in looks.items() if not settings.delays else ():
        if not (found := look()):
            continue
        late |= {topic: (by, how) for topic, by in found.items()}
        delays = tuple(f"{topic}={by:g}" for topic, (by, _) in late.items())
        reader = _checked(path, replace(settings, delays=delays), build, detect)
        for topic, (by, how) in late.items():
            reader.say(
                f"'{topic}': its stamps are {abs(by):.2f} s {'late' if by > 0 else 'early'}, to judge by {how}: taken "
                "out. read.delays settles it."
            )
    return with_sensors_in_place(reader)  # not before: who moves is elsewhere at another time


def _checked(path: Place | LogFile, settings: ReadSettings, build: Build, detect: DetectSettings) -> LogReader:
    return without_smeared_edges(with_crops(with_units(open_log(path, settings), build, detect)))


def read_log(path: Place, settings: ReadSettings | None = None) -> Recording:
    """Read a whole log into memory: see `open_checked`, `LogReader.frames` and `Recording`. Recordings of other formats
    are converted in passing.

    Raises LogError if the log cannot be read, holds nothing to track, or its units are in doubt; ValueError if
    `settings.max_points` is less than 1.
    """
    with as_mcap(path, (settings or ReadSettings()).types) as (log, notes):
        read = read_whole(open_checked(log, settings))
    return read if log is path else replace(read, path=str(path), notes=(*notes, *read.notes))
