"""The result of one log as replay reports it: small, so that thousands fit in memory; the tracks stay in their file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from voodoo_jax.records.notes import DAMAGED, INCOMPLETE, is_remark, plain
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.urls import fetched, joined


@dataclass(frozen=True)
class Outcome:
    """The result of one log."""

    path: str  # of the log, or its URL
    npz: str = ""  # where its tracks are; empty: failed
    frames: int = 0
    tracked: float = 0.0  # share of the frames, 0..1
    residual: float = math.nan  # mean over the frames, metres
    size: str = ""  # what was found of the body, such as "stature 1.832 m"
    seconds: float = 0.0  # of tracking, without reading, writing and compiling
    compile_seconds: float = 0.0
    total_seconds: float = 0.0  # all that was done for this log, 0 if it was skipped
    picture: str = ""  # where a picture was drawn
    error: str = ""
    notes: tuple[str, ...] = field(default=())
    skipped: bool = False  # an earlier run had done it already
    file_notes: tuple[str, ...] = ()  # about files that were made of the tracks, in this run
    folder: str = ""  # of its results within that of all, of one of several logs of one name
    person: int = 1  # whom the numbers are of: 1 who is seen longest
    others: tuple["Outcome", ...] = ()  # those of the other people in the log

    @property
    def name(self) -> str:
        """The log's name among all logs."""
        return joined(self.folder, Path(self.path).name)

    @property
    def ok(self) -> bool:
        """Whether the log was read and a person was tracked in it."""
        return bool(self.npz) and self.tracked > 0

    @property
    def damaged(self) -> bool:
        """Whether the log lost frames to damage, as its notes say."""
        return any(note.startswith((DAMAGED, INCOMPLETE)) for note in self.notes)

    @property
    def status(self) -> str:
        """In one or two words."""
        return "failed" if not self.npz else "tracked" if self.ok else "nothing tracked"

    @property
    def tracks(self) -> Tracks | None:
        """The tracks, read from their file; None for a log that failed. Raises OSError if the file is gone."""
        if not self.npz:
            return None
        from voodoo_jax.exporters.npz import read_tracks_npz

        with fetched(self.npz) as path:
            return read_tracks_npz(path)

    @property
    def people(self) -> tuple["Outcome", ...]:
        """Outcomes of everybody in the log, the person seen longest first."""
        return (replace(self, others=()), *self.others)

    def __str__(self) -> str:
        return self.words()

    def words(self, remarks: bool = True) -> str:
        """The outcome in lines, with or without notes that need no action."""
        return "\n".join(one._lines(bool(self.others), remarks) for one in self.people)

    def _lines(self, numbered: bool, remarks: bool) -> str:
        name = f"{plain(self.name)}, person {self.person}" if numbered else plain(self.name)
        if not self.npz:
            return f"{name}: FAILED: {self.error}"
        line = f"{name}: {self.frames} frames, {100 * self.tracked:.1f} % tracked, "
        line += f"residual {1000 * self.residual:.1f} mm, {self.size}"
        if self.skipped:
            line = f"{name}: skipped, finished before: " + line.removeprefix(f"{name}: ")
        elif self.seconds > 0:
            line += f", {self.frames / self.seconds:.0f} frames/s"
            if self.compile_seconds > 0.5:
                line += f" after {self.compile_seconds:.0f} s of compiling"
        if self.picture:
            line += f", picture {self.picture}"
        if not self.ok:
            line += "; NOTHING TRACKED"
        notes = [note for note in (*self.notes, *self.file_notes) if remarks or not is_remark(note)]
        return "\n".join([line, *(f"    {note}" for note in notes)])

    def rows(self) -> list[dict[str, Any]]:
        """A row for replay.jsonl of each person."""
        return [one.row() for one in self.people]

    def row(self) -> dict[str, Any]:
        """This person's outcome for replay.jsonl: numbers that are not finite become null."""
        return {
            "log": self.path,
            "person": self.person,
            "status": self.status,
            "skipped": self.skipped,
            "frames": self.frames,
            "tracked": round(self.tracked, 6),
            "residual_m": round(self.residual, 6) if math.isfinite(self.residual) else None,
            "body": self.size,
            "seconds": round(self.seconds, 3),
            "compile_seconds": round(self.compile_seconds, 3),
            "total_seconds": round(self.total_seconds, 3),
            "tracks": self.npz,
            "error": self.error,
            "notes": list(self.notes),
        }


def outcome_of(path: str, npz: str, tracks: Tracks, **more: Any) -> Outcome:
    """The outcome of a tracked log; `more` are other fields of Outcome."""
    body, times = tracks.body, {"seconds": tracks.seconds, "compile_seconds": tracks.compile_seconds}
    size = f"{body.scale_name} {float(body.scale):.3f} m"
    more |= {"notes": tracks.notes, "person": tracks.person}
    return _of(path, npz, tracks.tracked, tracks.evidence.residual, size, **times, **more)


def outcome_of_arrays(path: str, npz: str, data: Mapping[str, np.ndarray], **more: Any) -> Outcome:
    """The same from the arrays of a tracks file."""
    from voodoo_jax.exporters.npz import scale_of

    notes, (name, scale) = tuple(str(note) for note in data["notes"]), scale_of(data)
    size, seconds = f"{name} {scale:.3f} m", float(data["seconds"])
    person = int(data.get("person", 1))
    return _of(path, npz, data["tracked"], data["residual"], size, notes=notes, seconds=seconds, person=person, **more)


def _of(path: str, npz: str, tracked: np.ndarray, residual: np.ndarray, size: str, **more: Any) -> Outcome:
    share = float(tracked.mean()) if len(tracked) else 0.0
    mean = float(np.nanmean(residual)) if np.isfinite(residual).any() else math.nan
    return Outcome(path, npz, len(tracked), share, mean, size, **more)
