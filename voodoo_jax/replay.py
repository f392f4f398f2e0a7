"""Many logs: read, track, write, one after the other; a log that fails does not stop the others."""

import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm.auto import tqdm  # a bar in terminals and notebooks alike, 1 MB

from voodoo_jax.body import Body
from voodoo_jax.settings import Settings
from voodoo_jax.tracks import Tracks


@dataclass(frozen=True)
class Outcome:
    """What became of one log."""

    path: str
    tracks: Tracks | None  # None: failed
    error: str = ""
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the log was read and somebody was tracked in it."""
        return self.tracks is not None and bool(self.tracks.tracked.any())

    def __str__(self) -> str:
        name = Path(self.path).name
        if self.tracks is None:
            return f"{name}: FAILED: {self.error}"
        t = self.tracks
        share = 100 * float(t.tracked.mean()) if len(t.tracked) else 0.0
        residual = np.nanmean(t.residual) * 1000 if np.isfinite(t.residual).any() else float("nan")
        speed = len(t.time_ns) / t.seconds if t.seconds > 0 else float("nan")
        size = f"{t.body.scale_name} {float(t.body.scale):.3f} m"
        line = (
            f"{name}: {len(t.time_ns)} frames, {share:.1f} % tracked, residual {residual:.1f} mm, {size}, "
            f"{speed:.0f} frames/s"
        )
        if t.compile_seconds > 0.5:
            line += f" after {t.compile_seconds:.0f} s of compiling"
        if not self.ok:
            line += "; NOTHING TRACKED"
        return "\n".join([line, *(f"    {note}" for note in self.notes)])


def output_paths(log: str | os.PathLike[str], out: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Where the tracks of a log go: `<stem>.tracks.npz` and `<stem>.voodoo.mcap` in `out`."""
    stem = Path(log).name.removesuffix(".mcap")
    return Path(out) / f"{stem}.tracks.npz", Path(out) / f"{stem}.voodoo.mcap"


def track_log(path: str | os.PathLike[str], body: Body, settings: Settings, bar: tqdm | None = None) -> Tracks:
    """Reads a log frame by frame and tracks the body in it. Raises LogError."""
    from voodoo_jax.io.mcap_log import open_log
    from voodoo_jax.tracker import find_person, track_person

    log = open_log(path, settings.read)
    if bar is not None:
        bar.reset(total=(2 + settings.track.both_ways) * len(log))  # read, track there, and back

    def counted() -> Iterable:
        for frame in log.frames():
            if bar is not None:
                bar.update(1)
            yield frame

    scene, people = find_person(counted(), log.up, body, settings)

    def progress(done: int) -> None:
        if bar is not None:
            bar.update(done)

    return track_person(body, scene, people, settings, log.path, log.fixed_frame, log.notes, progress)


def draw(tracks: Tracks, target: Path, settings: Settings, count: int = 4) -> None:
    """Writes a picture of some frames of a tracked log, reading it once more but keeping these frames only."""
    from voodoo_jax.io.mcap_log import open_log
    from voodoo_jax.picture import picture, spread
    from voodoo_jax.recording import Recording

    log = open_log(tracks.source, settings.read)
    wanted = set(tracks.time_ns[spread(len(tracks.time_ns), count)].tolist())
    frames = tuple(frame for frame in log.frames() if frame.time_ns in wanted)
    picture(tracks, Recording(log.path, log.fixed_frame, log.up, log.sensors, frames), target, count)


def replay(
    logs: Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    body: Body | None = None,
    settings: Settings | None = None,
    quiet: bool = False,
    smooth_seconds: float = 0.0,
) -> list[Outcome]:
    """Tracks a body in each log and writes `<stem>.tracks.npz` and `<stem>.voodoo.mcap` into `out`.

    A log that cannot be read or tracked is reported in its Outcome, and the others are done all the same. Files appear
    under their final names only when complete. Raises ValueError if two logs would write the same files,
    or `smooth_seconds` (see smoothing.smooth) is negative.
    """
    from voodoo_jax.io.body_file import human
    from voodoo_jax.io.mcap_log import LogError
    from voodoo_jax.io.mcap_tracks import write_tracks_mcap
    from voodoo_jax.io.tracks_file import write_tracks_npz
    from voodoo_jax.smoothing import smooth

    if not smooth_seconds >= 0:
        raise ValueError(f"--smooth {smooth_seconds}: must not be negative")
    logs = [Path(p) for p in logs]
    settings, body = settings or Settings(), body or human()
    stems = [output_paths(p, out)[0].name for p in logs]
    twice = sorted({s for s in stems if stems.count(s) > 1})
    if twice:
        raise ValueError(
            f"several logs would write {', '.join(twice)}: replay logs of the same name into different folders"
        )
    Path(out).mkdir(parents=True, exist_ok=True)
    stages = {stage: values for stage, values in asdict(settings).items() if stage != "changes"}
    parameters = {f"{stage}.{k}": str(v) for stage, values in stages.items() for k, v in values.items()}
    parameters["smooth_seconds"] = str(smooth_seconds)
    parameters |= {f"change.{n}": str(change) for n, change in enumerate(settings.changes, 1)}
    outcomes: list[Outcome] = []
    for number, path in enumerate(logs, 1):
        with tqdm(desc=f"{number}/{len(logs)} {path.name}", unit="frame", disable=quiet or None, leave=False) as bar:
            try:
                tracks = smooth(track_log(path, body, settings, bar), smooth_seconds)
                npz, mcap = output_paths(path, out)
                write_tracks_mcap(tracks, mcap, parameters)
                write_tracks_npz(tracks, npz)  # last: where it is, both are
                outcome = Outcome(str(path), tracks, notes=tracks.notes)
            except LogError as problem:
                outcome = Outcome(str(path), None, str(problem))
            except Exception as problem:  # one log's trouble is not the others'
                outcome = Outcome(str(path), None, f"unexpected {type(problem).__name__}: {problem}")
        outcomes.append(outcome)
        if not quiet:
            tqdm.write(str(outcome))
    return outcomes
