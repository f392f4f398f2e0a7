"""The stages of tracking, in the order in which they run.

A segment begins by trials in all headings and the stages of START (see initialise.py). A new kind of start is a file in
start/, a new refinement one in refine/; each has a line in its list here, and a test file and a row of
experiments/ablation of the same name.
"""

from voodoo_jax.trackers.icp.initialise import START
from voodoo_jax.trackers.icp.refine.choose_facing import ChooseFacing
from voodoo_jax.trackers.icp.refine.drop_carried import DropCarried
from voodoo_jax.trackers.icp.refine.drop_unexplained import DropUnexplained
from voodoo_jax.trackers.icp.refine.fit_forearms import FitForearms
from voodoo_jax.trackers.icp.refine.fit_stature import FitStature
from voodoo_jax.trackers.icp.refine.fixed_lag import FixedLag
from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.refine.hang_arms import HangArms
from voodoo_jax.trackers.icp.refine.hang_legs import HangLegs
from voodoo_jax.trackers.icp.refine.mend_discontinuities import MendDiscontinuities
from voodoo_jax.trackers.icp.refine.place_joints import PlaceJoints
from voodoo_jax.trackers.icp.refine.restart_limbs import RestartLimbs
from voodoo_jax.trackers.icp.sequence import RecordingStage
from voodoo_jax.trackers.icp.stage import Named, Stage

# of every segment
SETTLE: tuple[Stage, ...] = (ForwardBackward(),)
# of every segment
REFINE: tuple[Stage, ...] = (
    *SETTLE, ChooseFacing(), RestartLimbs(), MendDiscontinuities(), FixedLag(),
)  # fmt: skip
# of the recording
FINISH: tuple[RecordingStage, ...] = (
    FitStature(among=REFINE), DropCarried(among=REFINE), DropUnexplained(among=REFINE), FitForearms(),
)  # fmt: skip
# of the tracks, once their poses stand
PLACE = (PlaceJoints(), HangLegs(), HangArms())


def stages() -> tuple[Named, ...]:
    """All stages of tracking."""
    return (*START, *REFINE, *FINISH, *PLACE)
