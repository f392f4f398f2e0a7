"""The notebooks' code runs from top to bottom, as a reader would run it."""

import json
from pathlib import Path

import matplotlib
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_cells_run(path, monkeypatch, tmp_path):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    cells = [c for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]
    kinds = {kind for c in cells for output in c["outputs"] for kind in output.get("data", [])}
    assert cells and "image/png" in kinds, "notebooks are kept with their outputs: see CONTRIBUTING.md"
    assert not any(output["output_type"] == "error" for c in cells for output in c["outputs"])
    names: dict = {}
    for number, cell in enumerate(cells):
        exec(compile("".join(cell["source"]), f"{path.name}, code cell {number}", "exec"), names)
    assert names["errors"].mean() < 0.03
