"""The eye's facing beside the tracker's at starts of midway.py: python -m experiments.eye.prior WEIGHTS.npz RECORDINGS
MIDWAY.json

Where they disagree, who is right? By the eye's logarithm of the odds in the first frame, and its mean over FRAMES.
"""

import json
import sys
from pathlib import Path

import numpy as np

import voodoo_jax as vj
from experiments.common import table
from experiments.eye import net
from experiments.eye.data import JOINTS
from experiments.eye.look import centred, thinned
from experiments.eye.midway import turned
from experiments.eye.start import NAMES

FRAMES, EVERY = 12, 3  # as many as the tracker's first_facing has; of so many one
EDGES = (0.0, 1.0, 2.0, 3.0, 5.0, np.inf)


def main(weights: str, recordings: str, midway: str) -> None:
    found = []  # tracker is wrong, odds that the eye gives the tracker's facing: first frame, mean
    errors = []
    for stem, rows in json.loads(Path(midway).read_text()).items():
        frames = vj.read_log(Path(recordings) / f"{stem}.mcap").frames
        for row in rows:
            if "joints" not in row:
                continue
            names, mine, truth = tuple(row["names"]), np.array(row["joints"]), np.array(row["truth"])
            order = [names.index(NAMES.get(n, n)) for n in JOINTS]
            column, first = mine[order][[JOINTS.index("l_hip"), JOINTS.index("r_hip")], :2].mean(0), row["frame"]
            way, odds = np.asarray(net.ahead(mine[order])), []
            for frame in frames[first + row["waited"] :][: FRAMES + 1 : EVERY]:
                seen = centred(Path(weights), thinned(frame.points), frame.origins[0].astype(float), column)
                if not odds:
                    errors.append((np.linalg.norm(seen.joints - truth[order], axis=1).mean(), row["cm"] / 100))
                odds.append(seen.odds * np.sign(np.asarray(net.ahead(seen.joints)) @ way))
            found.append((bool(turned(mine, truth, names)), odds[0], float(np.mean(odds))))
    wrong, one, mean = np.array(found, float).T
    for name, odds in (("first frame", one), (f"mean over {FRAMES} frames", mean)):
        rows = []
        for low, high in zip(EDGES, EDGES[1:]):
            against, for_it = (odds <= -low) & (odds > -high), (odds >= low) & (odds < high)
            counts = [against & (wrong > 0), against & (wrong == 0), for_it & (wrong == 0), for_it & (wrong > 0)]
            rows.append([f"{low:.0f} to {high:.0f}", *(str(int(c.sum())) for c in counts)])
        head = ["odds of the eye", "against, eye right", "against, tracker right", "both right", "both wrong"]
        print(name + "\n" + table(head, rows))
    eye, tracker = np.mean(errors, 0)
    turned_by = [100 * np.mean(some) for some in (wrong > 0, (one < 0) != wrong, (mean < 0) != wrong)]
    print(f"{len(found)} starts, turned: tracker, eye, its mean: " + ", ".join(f"{t:.1f} %" for t in turned_by))
    print(f"joints: eye {100 * eye:.1f} cm, tracker {100 * tracker:.1f} cm")


if __name__ == "__main__":
    main(*sys.argv[1:])
