"""The state of a search, and the file that it is saved in."""

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from voodoo_jax.geometry.arrays_file import arrays_in
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.troubles import opened_file


@dataclass(frozen=True)
class Progress:
    """The state of a search, complete for resuming."""

    x: Float64[np.ndarray, " all"]
    step: int = 0
    damping: float = 1e-3
    losses: tuple[float, ...] = ()
    done: bool = False


def save_progress(progress: Progress, path: str | os.PathLike[str], fingerprint: str) -> None:
    """Writes a state file atomically."""
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez(
            file, x=progress.x, step=progress.step, damping=progress.damping, losses=np.array(progress.losses),
            done=progress.done, fingerprint=np.array(fingerprint),
        )  # fmt: skip


def load_progress(path: str | os.PathLike[str], fingerprint: str) -> Progress | None:
    """Reads a state file; None if it does not exist, is broken, or belongs to another fit."""
    try:
        with opened_file(path) as stream:
            file = arrays_in(stream)
        if str(file["fingerprint"]) != fingerprint:
            return None
        losses = tuple(float(v) for v in file["losses"])
        return Progress(file["x"], int(file["step"]), float(file["damping"]), losses, bool(file["done"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def resumed(
    state: str | os.PathLike[str] | None,
    fingerprint: str,
    start: Float64[np.ndarray, " all"],
    tell: Callable[[str, Progress | None], None],
) -> tuple[Progress, Callable[[Progress], None]]:
    """Progress saved in the file `state`, or that of a new search from `start`; and a function that saves later
    progress and passes it to `tell`, to which the first progress is passed here."""

    def step_done(now: Progress) -> None:
        if state is not None:
            save_progress(now, state, fingerprint)
        tell("fitting", now)

    progress = (load_progress(state, fingerprint) if state is not None else None) or Progress(start)
    tell("fitting", progress)
    return progress, step_done
