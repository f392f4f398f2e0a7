"""How joints and bones are called in the files that are written, and how the skeletons in them stand."""

from dataclasses import dataclass
from typing import Literal

Names = Literal["", "hanim", "common", "h36m", "smpl", "opensim"]


@dataclass(frozen=True)
class Style:
    """Names and bind pose."""

    names: Names = ""
    """Names of joints: hanim (l_radiocarpal), common and smpl (left_wrist), h36m (LWrist), opensim (LWJC); empty: as
    the tracks have them, hanim where they are new."""
    rig: Literal["mixamo", "humanoid", "lafan1"] = "mixamo"
    """Names of a person's bones in BVH, glTF and USD: of Mixamo, of Unity's humanoids, or of LAFAN1."""
    pose: Literal["t", "a"] = "t"
    """How a person stands in the bind pose of BVH, glTF and USD: arms sideways (t), or half down (a)."""
