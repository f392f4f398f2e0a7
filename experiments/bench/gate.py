"""The regression gate: ratios of this run beside those of the committed baseline."""

import json
from pathlib import Path

BASELINE = Path(__file__).with_name("baseline.json")
SLACK = 0.25  # a ratio may fall by this share: a shared machine is not steadier
# this library, and whom it is compared with; not Numba on two threads, which a busy machine nearly stops
PAIRS = (("library", "c"), ("library_batch", "c_both"), ("library_batch", "numpy"))


def ratios(rates: dict[str, list[float]], points: int) -> dict[str, float]:
    """Medians over rounds of the ratios of frames per second, by name: "library/c@1000".

    **Arguments:** `rates` of each contender [round], in the same order of rounds.
    """
    found = {}
    for own, other in PAIRS:
        if own in rates and other in rates:
            each = sorted(a / b for a, b in zip(rates[own], rates[other]))
            middle = len(each) // 2
            median = each[middle] if len(each) % 2 else (each[middle - 1] + each[middle]) / 2
            found[f"{own}/{other}@{points}"] = round(median, 3)
    return found


def fallen(found: dict[str, float], baseline: dict[str, float], slack: float = SLACK) -> list[str]:
    """A line for every ratio that has fallen too far; ratios that only one of the two has say nothing."""
    return [
        f"{name}: {found[name]:.3f}, was {baseline[name]:.3f}"
        for name in sorted(found.keys() & baseline.keys())
        if found[name] < (1 - slack) * baseline[name]
    ]


def check(found: dict[str, float], processor: str, path: Path = BASELINE) -> int:
    """Prints what has fallen; the exit status: 1 if anything has, or if there was nothing to compare."""
    kept = json.loads(path.read_text())
    baseline = kept["ratios"]
    if not found.keys() & baseline.keys():
        print(f"nothing to compare with {path.name}")
        return 1
    bad = fallen(found, baseline)
    print("\n".join(["slower than the baseline:", *bad] if bad else ["no ratio has fallen"]))
    if bad and kept["machine"]["cpu"] != processor:
        # how fast NumPy is against compiled code depends on the processor by a third
        print(f"the baseline is of {kept['machine']['cpu']}, this is {processor}: compare with the code before, here")
    return int(bool(bad))
