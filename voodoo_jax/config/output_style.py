"""Names of joints and bones in exported files, and the bind pose of their skeletons."""

from dataclasses import dataclass
from typing import Literal

Names = Literal["", "hanim", "common", "h36m", "smpl", "opensim"]


@dataclass(frozen=True)
class Style:
    """Names and bind pose."""

    names: Names = ""
    """Convention for joint names, such as common (left_wrist); empty: unchanged."""
    rig: Literal["mixamo", "humanoid", "lafan1"] = "mixamo"
    """Skeleton of people in BVH, glTF, USD."""
    pose: Literal["t", "a"] = "t"
    """Bind pose of people's skeletons: T or A."""
