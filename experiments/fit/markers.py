"""Dimensions from optical markers alone: python -m experiments.fit.markers MARKER_RECORDINGS

Segments, stature and leg against the truth of a motion capture package (its joint centres) and against the tape. Writes
markers.md.
"""

import json
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import human, load_log, log_files, score, table, write
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import apply
from voodoo_jax.model.body import Body, segment_lengths, site_points

LIMBS = ("upper_arm", "forearm", "thigh", "shank")
NOTE = """
Found minus true or tape, cm. Leg: from the front of the pelvis (ASIS) down to the ankle joint at rest; the tape goes on
to the inner ankle bone, mean of left and right.
"""


def leg(body: Body) -> float:
    """From the front of the pelvis to the ankle's height, standing; metres, mean of left and right."""
    t = body.topology
    points = np.asarray(site_points(body, body.rest))
    parents = body.rest[np.array(t.parents, int)]
    joints = np.asarray(apply(parents, body.parent_anchor.translation))
    height = lambda all_of, names, name: np.mean([all_of[names.index(f"{s}_{name}"), 2] for s in "lr"])  # noqa: E731
    return float(height(points, t.sites, "asis") - height(joints, t.joints, "ankle"))


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
        off.append(np.abs(errors))
        stature = 100 * float(tracks.body.scale) - tape["Height"] / 10
        tape_leg = (tape["LLegLength"] + tape["RLegLength"]) / 20
        rows.append(
            [
                log.name,
                *(f"{v:+.2f}" for v in (*errors, stature, 100 * leg(tracks.body) - tape_leg)),
                f"{score(log, tracks).error_cm:.2f}",
            ]
        )
    mean = np.mean(off, 0)
    rows.append(["**mean size**", *(f"{v:.2f}" for v in mean), "", "", ""])
    head = ["recording", *(f"{k}, cm" for k in LIMBS), "stature, tape, cm", "leg, tape, cm", "joints, cm"]
    write(out, "markers", table(head, rows) + NOTE)


if __name__ == "__main__":
    tyro.cli(main)
