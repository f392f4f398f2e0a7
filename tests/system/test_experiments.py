"""Every experiment runs on the shipped recording, cut short, and writes its tables and figures."""

import importlib
from pathlib import Path

import matplotlib
import pytest

ROOT = Path(__file__).parents[2]
RUNS = {
    "fusion": (dict(frames=40), ("fusion.md", "fusion.png")),
    "table1": (dict(frames=40), ("table1.md", "table1.png")),
    "ratio": (dict(frames=40, ratios=(0.3, 0.6), solvers=("coupled",)), ("ratio.md", "ratio.png")),
    "overlap": (dict(frames=40, rules=("exclusive",), solvers=("coupled",)), ("overlap.md",)),
    "steps": (
        dict(frames=40, points=256, counts=(2, 4), epsilon=(), solvers=("coupled",), turns=1),
        ("steps.md", "steps.png", "steps_time.md", "steps_time.png"),
    ),
    "measurements": (
        dict(frames=40, points=(128, 256), features=(8,), turns=1),
        ("measurements.md", "measurements.png"),
    ),
    "stress": (dict(frames=40, only="as they are", processes=1), ("stress.md", "stress.png")),
    "ablation": (dict(frames=40, only="prior*", processes=1), ("ablation.md", "ablation.png")),
    "forearms": (dict(frames=40), ("forearms.md", "forearms.png")),
    "offsets": (dict(frames=40, oracles=False), ("offsets.md",)),
    "trust": (dict(frames=40, changes=("as they are",), processes=1), ("trust.md", "trust.png")),
}


@pytest.mark.parametrize("name", RUNS)
def test_runs_on_the_shipped_recording(name, monkeypatch, tmp_path):
    matplotlib.use("Agg")
    monkeypatch.syspath_prepend(ROOT)
    options, files = RUNS[name]
    importlib.import_module(f"experiments.{name}.__main__").main(**options, out=tmp_path)
    assert {f.name for f in tmp_path.iterdir()} == set(files)
    for file in files:
        text = (tmp_path / file).read_bytes()
        assert b"nan" not in text if file.endswith(".md") else 5_000 < len(text) < 200_000


@pytest.mark.usefixtures("compiled_in_a_hurry")
def test_derivatives_are_differences_unless_a_point_changes_limbs(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(ROOT)
    module = importlib.import_module("experiments.gradients.__main__")
    module.main(pairs=4, logs=1, frames=6, points=64, out=tmp_path)
    page = (tmp_path / "gradients.md").read_text()
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| 1e")]
    moving = 4 - int(page.split(" of 4 pairs' frames are at rest")[0].split()[-1])  # they have no derivative yet
    assert len(rows) == len(module.STEPS) and moving <= 1
    assert all(int(row[3].split()[0]) <= moving for row in rows)
    assert int(rows[-1][1].split()[0]) >= 3 and float(rows[-1][4].split()[0]) < 0.1


@pytest.mark.parametrize(
    "mask, length", [([], 0), ([0, 0], 0), ([1, 1, 0, 1], 2), ([0, 1, 1, 1], 3)], ids=["empty", "none", "first", "last"]
)
def test_longest_run(mask, length, monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    assert importlib.import_module("experiments.common").longest(mask) == length
