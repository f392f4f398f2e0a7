"""Every stage of detection and tracking has a file, a test file and a row of the ablation under its name."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from voodoo_jax.detect import pipeline as detection
from voodoo_jax.trackers.icp import pipeline as icp

ROOT = Path(__file__).parents[3]
PLACES = [("detect", s) for s in detection.stages()]
PLACES += [(f"trackers/icp/{'start' if s in icp.START else 'refine'}", s) for s in icp.stages()]


@pytest.mark.parametrize("folder, stage", PLACES, ids=[stage.name for _, stage in PLACES])
def test_one_name(folder, stage, monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    rows = import_module("experiments.ablation.variants").VARIANTS
    assert type(stage).__module__ == f"voodoo_jax.{folder.replace('/', '.')}.{stage.name}"
    assert re.sub("(?<!^)([A-Z])", r"_\1", type(stage).__name__).lower() == stage.name
    assert (ROOT / "tests" / folder / f"test_{stage.name}.py").exists()
    section = "detect" if folder == "detect" else "track"
    assert rows[f"without {stage.name}"] == {f"{section}.skip": (stage.name,)}


def test_names_are_given_once():
    for stages in (detection.stages(), icp.stages()):
        assert len({stage.name for stage in stages}) == len(stages)
        assert "looks_ahead" not in {stage.name for stage in stages}
