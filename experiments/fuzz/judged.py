"""What must not come of a damaged or hostile log."""

import math
from typing import Any

from experiments.fuzz.kinds import Input
from experiments.fuzz.trying import PEAK, SECONDS

APART = 0.15  # metres that joints may be elsewhere where frames before are missing
FAR = 1000.0  # metres: nobody is so far from the camera
DAMAGED = ("damage", "incomplete", "is not an MCAP log", "is empty", "holds no messages")


def faults(one: Input, found: dict[str, Any], clean: dict[str, Any]) -> list[str]:
    """What is wrong with what came of a log, in words; `clean` what came of the sound one."""
    if "crash" in found:
        return [f"crash ({found['crash']})"]
    if "hang" in found:
        return [f"hang, ended after {found['hang']:.0f} s"]
    said = found["info"] + found["error"] + found.get("said", "") + "".join(found["notes"])
    wrong = {
        "traceback": found["trace"] or found["error"].startswith("unexpected"),
        # programs are compiled in two threads
        "time": found["seconds"] - 2 * found.get("compiling", 0) > SECONDS,
        "memory": found["peak"] > PEAK or "out of memory" in said or "allocate" in said,
        "not finite": not found.get("finite", True),
        "absurd": found.get("far", 0) > FAR and "are large" not in said,  # of coordinates that are, a note says so
        "control characters": not said.replace("\n", "").isprintable(),
        "long words": len(said) > 100_000,
        "refused without a word of damage": one.damaged and found["error"] and not _says(found["error"]),
    }
    return [name for name, is_so in wrong.items() if is_so] + _silent(one, found, clean)


def _says(text: str) -> bool:
    return any(word in text for word in DAMAGED)


def _silent(one: Input, found: dict[str, Any], clean: dict[str, Any]) -> list[str]:
    """Loss, or another result, that nobody is told of."""
    quiet = not found["error"] and not set(found["notes"]) - set(clean["notes"])
    wrong = []
    if quiet and one.damaged and found["count"] < clean["count"]:
        wrong.append("silent loss")
    if one.damaged and quiet and not _alike(found, clean):
        wrong.append("silent change")
    if one.damaged and found.get("frames", {}).items() - clean.get("frames", {}).items():
        wrong.append("changed frames")
    return wrong


def _alike(found: dict[str, Any], clean: dict[str, Any]) -> bool:
    for time, joints in found.get("joints", {}).items():
        before = clean["joints"].get(time)
        if before is None or max(map(math.dist, joints, before)) > APART:
            return False
    return True
