"""The benchmark's contenders do the same work, and its gate tells a regression."""

import importlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from voodoo_jax.geometry.rigid import apply, matrix
from voodoo_jax.model.body import band_mask, bands
from voodoo_jax.model.body_file import load_body

ROOT = Path(__file__).parents[2]


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    return lambda name: importlib.import_module(f"experiments.bench.{name}")


def small_work(bench, rng):
    """The papers' body in its rest pose, 2 cm and some degrees beside where its points are; two frames."""
    body = load_body("human10")
    sizes, links = np.asarray(body.sizes), bands(body)
    surface = bench("peers.assigned").surface
    seen = [np.asarray(apply(body.rest[l], surface(size, 30))) for l, size in enumerate(sizes)]
    frames = np.stack([np.concatenate(seen).T + shift for shift in (0.0, 0.01)])
    start = np.asarray(body.rest.translation) + rng.normal(0, 0.02, (len(sizes), 3))
    floats = {
        "size": sizes, "R": matrix(body.rest.rotation), "t": start, "pa": links.first_points,
        "pc": links.second_points, "bm": band_mask(body.axes), "w": body.weights,
    }  # fmt: skip
    return bench("work").Work(
        **{k: np.asarray(v, np.float32) for k, v in floats.items()},
        parent=np.asarray(links.first, np.int32), child=np.asarray(links.second, np.int32),
        points={300: frames.astype(np.float32)},
    )  # fmt: skip


@pytest.mark.parametrize("peer", ["c_step", "library"])
def test_the_same_poses_as_numpy(bench, rng, peer):
    if peer == "c_step" and shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    work = small_work(bench, rng)
    R, t = bench("peers.numpy_step").build(work, 300)()
    assert 0.01 < np.abs(t - work.t).max() < 0.1  # there was something to do
    found_R, found_t = bench(f"peers.{peer}").build(work, 300)()
    np.testing.assert_allclose(found_t, t, atol=1e-3)
    np.testing.assert_allclose(found_R, R, atol=3e-3)


def test_files_keep_the_work(bench, rng, tmp_path):
    work = small_work(bench, rng)
    bench("work").save(work, tmp_path / "work.npz")
    again = bench("work").load(tmp_path / "work.npz")
    np.testing.assert_array_equal(again.frames(300), work.frames(300))
    np.testing.assert_array_equal(again.band_weight, work.band_weight)


def test_the_gate_tells_a_regression(bench, tmp_path, capsys):
    gate = bench("gate")
    rates = {"library_batch": [400.0, 500.0, 400.0], "c_both": [1000.0, 1000.0, 4000.0], "numpy": [40.0, 40.0, 40.0]}
    found = gate.ratios(rates, 1000)
    assert found == {"library_batch/c_both@1000": 0.4, "library_batch/numpy@1000": 10.0}
    baseline = tmp_path / "baseline.json"
    for was, status, here, elsewhere in ((0.5, 0, "B", False), (0.6, 1, "A", False), (0.6, 1, "B", True)):
        kept = found | {"library_batch/c_both@1000": was, "other@1": 9.0}
        baseline.write_text(json.dumps({"ratios": kept, "machine": {"cpu": "A"}}))
        assert gate.check(found, here, baseline) == status
        said = capsys.readouterr().out
        assert ("library_batch/c_both@1000: 0.400, was 0.600" in said) == bool(status)
        assert ("the baseline is of A, this is B" in said) == elsewhere
    assert gate.check({}, "A", baseline) == 1


def test_the_committed_baseline_holds_the_gates_ratios(bench):
    gate = bench("gate")
    kept = json.loads(gate.BASELINE.read_text())["ratios"]
    assert {name.split("@")[0] for name in kept} == {f"{own}/{other}" for own, other in gate.PAIRS}


def test_streams_elsewhere_in_the_room_end_where_c_does(bench, rng):
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    row = bench("devices").measure(small_work(bench, rng), 300, "per_limb", 2, 1, 1.0, 0.0)
    named = dict(zip(bench("devices").HEAD, row, strict=True))
    assert float(named["best, frames/s"]) > 0 and float(named["from C's, mm"]) < 1.0
    assert named["of the devices' flop/s"].endswith("%") and named["of their bytes/s"] == ""
