"""Draws learning curves: python -m experiments.eye.curve OUT.png CURVE.json ..."""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt


def main(out: str, *curves: str) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.2), constrained_layout=True)
    for path in curves:
        rows = json.loads(Path(path).read_text())
        seen = [row["seen"] / 1e3 for row in rows]
        for axis, name, by in zip(axes, ("test_joint", "test_turned", "test_person"), (100, 100, 100)):
            axis.plot(seen, [by * row[name] for row in rows], label=Path(path).name.split(".")[0])
    for axis, title in zip(axes, ("joints, cm", "turned, %", "somebody or not, right, %")):
        axis.set(xlabel="crops seen, thousands", title=title)
        axis.grid(alpha=0.3)
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
