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

    at: int  # frame in which the search begins
    best: StartHypothesis  # may begin in a later frame
    found: tuple[StartHypothesis, ...]  # standing starts, from this frame and from later ones
    stance: Stance | None = None  # of the best start; None: standing


@runtime_checkable
class StartStage(Named, Protocol):
    """Tries further starts and returns the search with the best one."""

    def __call__(self, run: Runner, search: Search) -> Search: ...
