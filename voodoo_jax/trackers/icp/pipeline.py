"""The stages of tracking, in the order in which they run.

A new correction is a file in refine/, a line here, a test file and a row of experiments/ablation of the same name.
"""

from voodoo_jax.trackers.icp.refine.choose_facing import ChooseFacing
from voodoo_jax.trackers.icp.refine.drop_unexplained import DropUnexplained
from voodoo_jax.trackers.icp.refine.fit_forearms import FitForearms
from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.refine.mend_discontinuities import MendDiscontinuities
from voodoo_jax.trackers.icp.refine.restart_limbs import RestartLimbs
from voodoo_jax.trackers.icp.refine.stage import Named, Stage
from voodoo_jax.trackers.icp.refine.swap_legs import SwapLegs
from voodoo_jax.trackers.icp.sequence import RecordingStage

# of every segment, and of each that competes with it: before the ways to face are compared, for who faces the right way
# with the legs exchanged costs more than who faces the other way
SETTLE: tuple[Stage, ...] = (ForwardBackward(), SwapLegs())
# of every segment
REFINE: tuple[Stage, ...] = (*SETTLE, ChooseFacing(among=SETTLE), RestartLimbs(), MendDiscontinuities())
# of the recording
FINISH: tuple[RecordingStage, ...] = (DropUnexplained(among=REFINE), FitForearms())


def stages() -> tuple[Named, ...]:
    """All stages of tracking."""
    return (*REFINE, *FINISH)
