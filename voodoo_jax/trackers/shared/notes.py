"""Notes on implausible poses in tracks."""

from dataclasses import replace

import numpy as np

from voodoo_jax.records.tracks import Tracks

FAR_BEYOND, DEEP = 20.0, 0.04  # degrees beyond a joint's limit, metres inside another limb: worth a note
ODD = "Not plausible"  # sentences on the tracks themselves begin so


def implausible(tracks: Tracks) -> list[str]:
    """Notes on joints beyond their limits and limbs inside others, if in many tracked frames."""
    beyond, depth = tracks.evidence.beyond_limits, tracks.evidence.depth_inside
    assert beyond is not None and depth is not None
    notes, tracked, t = [], tracks.tracked, tracks.body.topology
    for what, names, found, most in (
        (f"bent more than {FAR_BEYOND:.0f} degrees beyond their limits", t.joints,
         np.degrees(beyond), FAR_BEYOND),
        (f"more than {100 * DEEP:.0f} cm inside other limbs", t.limbs, depth, DEEP),
    ):  # fmt: skip
        with np.errstate(invalid="ignore"):
            share = (found[tracked] > most).mean(0) if tracked.any() else np.zeros(len(names))
        often = [f"{names[k]} ({100 * share[k]:.0f} %)" for k in np.argsort(-share) if share[k] > 0.05]
        if often:
            notes.append(f"{ODD}, {what} (share of the frames): {', '.join(often)}.")
    return notes


def looked_at_again(tracks: Tracks) -> Tracks:
    """Tracks after a change of poses, with their notes renewed."""
    kept = [note for note in tracks.notes if not note.startswith(ODD)]
    return replace(tracks, notes=(*implausible(tracks), *kept))
