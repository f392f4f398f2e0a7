"""Inputs and outputs of a stage of the start.

The name of a stage is its file, its switch (`track.skip`), its test file and its row in experiments/ablation.
"""

from typing import NamedTuple, Protocol, runtime_checkable

from voodoo_jax.model.pose_library import Stance
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.stage import Named
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis


class Search(NamedTuple):
    """The search for the start of a segment."""

    at: int  # frame in which it begins
    best: StartHypothesis  # may be of a later frame
    found: tuple[StartHypothesis, ...]  # standing, of this frame and of later ones
    stance: Stance | None = None  # of the best one, if it does not stand


@runtime_checkable
class StartStage(Named, Protocol):
    """A further kind of start."""

    def __call__(self, run: Runner, search: Search) -> Search: ...
