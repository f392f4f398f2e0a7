"""A log opened for tracking: what it says of units and clocks is compared with what it shows. Host side."""

from collections.abc import Callable
from dataclasses import replace

from voodoo_jax.config.options import DetectSettings, ReadSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.crops import with_crops
from voodoo_jax.detect.delays import offsets
from voodoo_jax.detect.late_transforms import late_transforms
from voodoo_jax.detect.misplaced import with_sensors_in_place
from voodoo_jax.detect.smeared_edges import without_smeared_edges
from voodoo_jax.detect.units import with_units
from voodoo_jax.io.container import LogFile, Place
from voodoo_jax.io.convert.in_passing import as_mcap
from voodoo_jax.io.log_reader import LogReader, open_log, read_whole
from voodoo_jax.records.recording import Recording

PERSON = Build(1.70, 0.44)  # where nobody says who is looked for: the size of the body file `human`, measured


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


def read_log(
    path: Place,
    settings: ReadSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Reads a whole log into memory: see `open_checked`, `LogReader.frames` and `Recording`. Recordings of other
    formats are converted first.

    Raises LogError if the log cannot be read, has no usable measurements, or its units are ambiguous; ValueError if
    `settings.max_points` is less than 1.
    """
    with as_mcap(path, (settings or ReadSettings()).types) as (log, notes):
        read = read_whole(open_checked(log, settings), progress)
    return read if log is path else replace(read, path=str(path), notes=(*notes, *read.notes))
