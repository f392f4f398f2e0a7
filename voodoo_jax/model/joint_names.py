"""Names of joint centres and limbs in other conventions: left_wrist, LWrist, WRIST_LEFT, leftWrist, r.ankle."""

import re
from collections.abc import Mapping, Sequence

from voodoo_jax.config.toml import nearest

LEFT, RIGHT = {"left", "l", "lft"}, {"right", "r", "rgt"}
# words that name no place: of Kinect's and others' enumerations
SILENT = {"joint", "center", "centre", "mixamorig", "kinect", "k4abt", "k", "4", "abt", "jointtype", "type"}
# what is left of a name, in small letters: H-Anim v2
WORDS = {
    "wrist": "radiocarpal", "ankle": "talocrural", "neck": "vc7", "c7": "vc7", "spineshoulder": "vc7",
    "shoulderspine": "vc7", "head": "skullbase", "skull": "skullbase", "skullbase": "skullbase",
    "arm": "shoulder", "upperarm": "shoulder", "forearm": "elbow", "lowerarm": "elbow", "upleg": "hip",
    "upperleg": "hip", "thigh": "hip", "leg": "knee", "lowerleg": "knee", "shank": "knee", "stifle": "stifle",
}  # fmt: skip
# the same for limbs: those of the body files of people
LIMB_WORDS = {
    "arm": "upper_arm", "upperarm": "upper_arm", "humerus": "upper_arm", "lowerarm": "forearm", "radius": "forearm",
    "ulna": "forearm", "upperleg": "thigh", "upleg": "thigh", "femur": "thigh", "lowerleg": "shank", "leg": "shank",
    "calf": "shank", "tibia": "shank", "hips": "pelvis", "hip": "pelvis", "trunk": "torso", "thorax": "chest",
    "spine": "chest", "skull": "head",
}  # fmt: skip
PIECES = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


# what conventions call the joint centres of people: how a name gets its side, and the words that differ from H-Anim v2;
# SMPL's neck and head are what is meant by C7 and the base of the skull; RFoot is Human3.6M's ankle; OpenSim's models
# have joint centres as markers of such names
CONVENTIONS: dict[str, tuple[str, str, dict[str, str]]] = {
    "common": ("left_{}", "right_{}", {
        "skullbase": "head", "vc7": "neck", "radiocarpal": "wrist", "talocrural": "ankle",
    }),
    "h36m": ("L{}", "R{}", {
        "skullbase": "Neck", "vc7": "Thorax", "shoulder": "Shoulder", "elbow": "Elbow", "radiocarpal": "Wrist",
        "hip": "Hip", "knee": "Knee", "talocrural": "Foot",
    }),
    "opensim": ("L{}", "R{}", {
        "skullbase": "Head", "vc7": "Neck", "shoulder": "SJC", "elbow": "EJC", "radiocarpal": "WJC", "hip": "HJC",
        "knee": "KJC", "talocrural": "AJC",
    }),
}  # fmt: skip
CONVENTIONS["smpl"] = CONVENTIONS["common"]


def named(centres: Sequence[str], convention: str) -> tuple[str, ...]:
    """Joint centres by the names of a convention: hanim (as in body files), common, h36m, smpl or opensim. Those
    without a name there keep theirs. Raises ValueError for another convention."""
    if convention == "hanim":
        return tuple(centres)
    if convention not in CONVENTIONS:
        raise ValueError(f"no names '{convention}'{nearest(convention, ['hanim', *CONVENTIONS])}")
    left, right, words = CONVENTIONS[convention]
    known = {*words, "shoulder", "elbow", "hip", "knee"}
    found = []
    for centre in centres:
        side, plain = (
            ({"l_": left, "r_": right}[centre[:2]], centre[2:]) if centre[:2] in ("l_", "r_") else ("{}", centre)
        )
        found.append(side.format(words.get(plain, plain)) if plain in known else centre)
    return tuple(found)


def joint_row(centres: Sequence[str], name: str) -> int:
    """Row of a body's joint centre by name: its own name, or that of another convention.

    Raises ValueError with near names.
    """
    if (row := row_of(centres, name)) is not None:
        return row
    common = named(centres, "common")
    for convention in ("common", "h36m", "opensim"):
        if name in (others := named(centres, convention)):
            return others.index(name)
    raise ValueError(f"no joint centre '{name}'{nearest(name, [*centres, *common])}")


def row_of(names: Sequence[str], name: str, words: Mapping[str, str] = WORDS) -> int | None:
    """Row of a body's name that another one means; None: none of them. `words` WORDS for joint centres, LIMB_WORDS for
    limbs."""
    wanted = next((own for own in (name, *_meanings(name, words)) if own in names), None)
    return None if wanted is None else list(names).index(wanted)


def _meanings(name: str, words: Mapping[str, str]) -> list[str]:
    """Possible names in this body, the likelier first."""
    pieces = [piece.lower() for piece in PIECES.findall(name)]
    stem = "".join(p for p in pieces if p not in LEFT | RIGHT | SILENT)
    side = "l_" if LEFT & set(pieces) else "r_" if RIGHT & set(pieces) else ""
    found = [side + stem, side + words.get(stem, stem)]
    if not side and stem[:1] in ("l", "r"):  # lwrist, rknee
        found += [f"{stem[0]}_{stem[1:]}", f"{stem[0]}_{words.get(stem[1:], stem[1:])}"]
    digits = "".join(pieces)  # vc7, c7
    return [*found, digits, words.get(digits, digits)]
