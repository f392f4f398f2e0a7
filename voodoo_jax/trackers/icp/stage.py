"""What a refinement takes and gives, and how a list of refinements is gone through.

The name of a stage is its file, its switch (`track.skip`), its test file and its row in experiments/ablation.
"""

from collections.abc import Iterable
from typing import ClassVar, Protocol, runtime_checkable

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.segment import Followed


@runtime_checkable
class Named(Protocol):
    """What every stage says of itself."""

    name: ClassVar[str]
    looks_ahead: ClassVar[bool]  # uses later frames: left out with Settings.online
    needs: ClassVar[frozenset[str]]  # of Runner.offers: else it is passed over


@runtime_checkable
class Stage(Named, Protocol):
    """One correction of a segment, once it is tracked. It gives back the same segment where it changes nothing."""

    def __call__(self, run: Runner, segment: Followed) -> Followed: ...


def is_active(run: Runner, stage: Named) -> bool:
    """Whether a stage is neither switched off nor of no use for what is tracked."""
    skipped = run.settings.skips("track", stage.name, stage.looks_ahead)
    return not skipped and stage.needs <= run.offers


def refined(run: Runner, segment: Followed, stages: Iterable[Stage]) -> Followed:
    """The segment after all stages that are active, in their order."""
    for stage in stages:
        if is_active(run, stage):
            segment = stage(run, segment)
    return segment
