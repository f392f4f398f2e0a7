"""Joint centres under the names of other conventions: left_wrist, LWrist, WRIST_LEFT, l_wrist, leftWrist, r.ankle."""

import re
from collections.abc import Sequence

from voodoo_jax.model.checked_toml import nearest

LEFT, RIGHT = {"left", "l", "lft"}, {"right", "r", "rgt"}
# words that name no place: of Kinect's and others' enumerations
SILENT = {"joint", "center", "centre", "kinect", "k4abt", "k", "4", "abt", "jointtype", "type"}
# what is left of a name, in small letters: H-Anim v2
WORDS = {
    "wrist": "radiocarpal", "ankle": "talocrural", "neck": "vc7", "c7": "vc7", "spineshoulder": "vc7",
    "shoulderspine": "vc7", "head": "skullbase", "skull": "skullbase", "skullbase": "skullbase",
    "arm": "shoulder", "upperarm": "shoulder", "forearm": "elbow", "lowerarm": "elbow", "upleg": "hip",
    "upperleg": "hip", "thigh": "hip", "leg": "knee", "lowerleg": "knee", "shank": "knee", "stifle": "stifle",
}  # fmt: skip
PIECES = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


def joint_row(centres: Sequence[str], name: str) -> int:
    """Which of a body's joint centres a name means: its own name, or that of another convention.

    Raises ValueError with near names.
    """
    if name in centres:
        return list(centres).index(name)
    for wanted in _meanings(name):
        if wanted in centres:
            return list(centres).index(wanted)
    raise ValueError(f"no joint centre '{name}'{nearest(name, centres)}; there are {', '.join(centres)}")


def _meanings(name: str) -> list[str]:
    """Names that this body may have for it, the likelier first."""
    pieces = [piece.lower() for piece in PIECES.findall(name)]
    stem = "".join(p for p in pieces if p not in LEFT | RIGHT | SILENT)
    side = "l_" if LEFT & set(pieces) else "r_" if RIGHT & set(pieces) else ""
    found = [side + stem, side + WORDS.get(stem, stem)]
    if not side and stem[:1] in ("l", "r"):  # lwrist, rknee
        found += [f"{stem[0]}_{stem[1:]}", f"{stem[0]}_{WORDS.get(stem[1:], stem[1:])}"]
    digits = "".join(pieces)  # vc7, c7
    return [*found, digits, WORDS.get(digits, digits)]
