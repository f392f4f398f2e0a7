"""How joints and bones are called in the files that are written, and how the skeletons in them stand."""

from dataclasses import dataclass
from typing import Literal

Names = Literal["", "hanim", "common", "h36m", "smpl", "opensim"]


@dataclass(frozen=True)
class Style:
    """Names and bind pose."""

    names: Names = ""
    """Names of joints; common: left_wrist."""
    rig: Literal["mixamo", "humanoid", "lafan1"] = "mixamo"
    """Bones of people in BVH, glTF, USD."""
    pose: Literal["t", "a"] = "t"
    """In which people's skeletons are bound."""
