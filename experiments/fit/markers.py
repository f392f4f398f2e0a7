"""Dimensions from optical markers alone: python -m experiments.fit.markers MARKER_RECORDINGS

Segments, stature and leg against the truth of a motion capture package (its joint centres) and against the tape. Writes
markers.md.
"""

import json
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import Log, human, load_log, log_files, score, table, write
from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import segment_lengths
from voodoo_jax.model.marker_sets import plain_name
from voodoo_jax.records.tracks import Tracks

LIMBS = {
    "upper_arm": ("shoulder", "elbow"), "forearm": ("elbow", "radiocarpal"), "thigh": ("hip", "knee"),
    "shank": ("knee", "talocrural"),
}  # fmt: skip
RIGID = 0.01  # metres, by hand: a segment of the truth that varies more in a clip (standard deviation) is no length
NOTE = """
Found minus true or tape, cm. In brackets, and not in the mean: the truth's own segment varies by more than 1 cm within
the clip, so it is no length. Leg: thigh, shank and the height of the markers on the front of the pelvis (ASIS) over the
hips; the tape goes on to the inner ankle bone, mean of left and right.
"""


def varies(log: Log, ends: tuple[str, str]) -> bool:
    """Whether a segment of the truth is longer at some times of the clip than at others."""
    a, b = ([log.joints[:, log.names.index(f"{side}_{end}")] for side in "lr"] for end in ends)
    return any(np.nanstd(np.linalg.norm(p - q, axis=-1)) > RIGID for p, q in zip(a, b))


def leg(log: Log, tracks: Tracks) -> float:
    """As a tape measures it, of a person who stands or walks; metres, mean of left and right."""
    found, hips = segment_lengths(tracks.body), []
    for side in "lr":
        hip = tracks.joints[:, tracks.body.topology.centres.index(f"{side}_hip"), 2]
        for frame, height in zip(log.people, hip):
            names = [plain_name(name) for name in frame.pairs.names]
            if f"{side.upper()}ASI" in names:
                hips.append(frame.pairs.points[names.index(f"{side.upper()}ASI"), 2] - height)
    return float(found["thigh"] + found["shank"] + np.nanmedian(hips))


def main(recordings: tyro.conf.Positional[Path], frames: int = 0, out: Path = Path(__file__).parent) -> None:
    """Dimensions from optical markers alone.

    Args:
        recordings: folder with *.mcap of markers and *.truth.npz with `dims` and `measured`.
        frames: cut recordings after so many frames; 0: whole.
        out: folder for markers.md.
    """
    body, settings, rows, off = human(), Settings(), [], []
    for path in tqdm(log_files(recordings), "markers", unit="log", leave=False, disable=None):
        log = load_log(path, body, settings, frames)
        tracks = log.track(body, settings)
        with np.load(path.with_suffix(".truth.npz"), allow_pickle=False) as file:
            dims, tape = json.loads(str(file["dims"])), json.loads(str(file["measured"]))
        found = segment_lengths(tracks.body)
        errors = [100 * (found[name] - dims[name]) for name in LIMBS]
        no_length = [varies(log, ends) for ends in LIMBS.values()]
        off.append(np.where(no_length, np.nan, np.abs(errors)))
        stature = 100 * float(tracks.body.scale) - tape["Height"] / 10
        tape_leg = (tape["LLegLength"] + tape["RLegLength"]) / 20
        rows.append(
            [
                log.name,
                *(f"({v:+.2f})" if no else f"{v:+.2f}" for v, no in zip(errors, no_length)),
                *(f"{v:+.2f}" for v in (stature, 100 * leg(log, tracks) - tape_leg)),
                f"{score(log, tracks).error_cm:.2f}",
            ]
        )
    mean = np.nanmean(off, 0)
    rows.append(["**mean size**", *(f"{v:.2f}" for v in mean), "", "", ""])
    head = ["recording", *(f"{k}, cm" for k in LIMBS), "stature, tape, cm", "leg, tape, cm", "joints, cm"]
    write(out, "markers", table(head, rows) + NOTE)


if __name__ == "__main__":
    tyro.cli(main)
