"""Inputs and outputs of refinements, and how a list of them runs.

The name of a stage is its file, its switch (`track.skip`), its test file and its row in experiments/ablation.
"""

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from voodoo_jax.detect.stage import Named as Named
from voodoo_jax.solve.scan import State
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.segment import Followed


@runtime_checkable
class Stage(Named, Protocol):
    """A correction of a tracked segment. It returns the same segment if it changes nothing."""

    def __call__(self, run: Runner, segment: Followed) -> Followed: ...


@runtime_checkable
class CausalStage(Named, Protocol):
    """A stage that also corrects frames by earlier ones alone."""

    def so_far(self, run: Runner, segment: Followed) -> tuple[Followed, State | None]: ...


def is_active(run: Runner, stage: Named, causal: bool = False) -> bool:
    """Whether a stage, or its causal form, is switched on and has its inputs."""
    skipped = run.settings.skips("track", stage.name, stage.looks_ahead and not causal)
    return not skipped and stage.needs <= run.offers


def refined(run: Runner, segment: Followed, stages: Iterable[Stage]) -> Followed:
    """The segment after all stages that are active, in their order."""
    for stage in stages:
        if is_active(run, stage):
            segment = stage(run, segment)
    return segment


def looked(run: Runner, segment: Followed, stages: Iterable[Stage]) -> tuple[Followed, State | None]:
    """Frames that were just tracked, after the stage that corrects them by earlier ones: see Method.looked."""
    for stage in stages:
        if isinstance(stage, CausalStage) and is_active(run, stage, causal=True):
            return stage.so_far(run, segment)
    return segment, None
