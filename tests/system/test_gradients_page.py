"""The lines that README.md begins with run as they stand there, and their gradient is that of the error."""

import re
import shutil
from importlib.resources import files
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).parents[2]


def test_the_first_lines_of_the_readme(tmp_path, monkeypatch, request):
    text = (ROOT / "README.md").read_text()
    block = re.search(r"```python\n(import jax, voodoo_jax.*?)```", text, re.DOTALL)
    assert block is not None and text.index(block[0]) < text.index("## Try it")
    lines = [line for line in block[1].splitlines() if line]
    assert len(lines) == 6
    for suffix in (".mcap", ".truth.npz"):
        shutil.copy(str(files("voodoo_jax") / "data" / f"demo{suffix}"), tmp_path / f"bow{suffix}")
    monkeypatch.chdir(tmp_path)
    # a part of the recording, compiled in a hurry
    lines[1] = lines[1].replace('.npz")', '.npz", frames=8, points=64)')
    lines[5] = lines[5].replace("])", "], steps=2)")
    names: dict = {}
    exec("\n".join(lines[:2]), names)
    jax.config.update("jax_disable_most_optimizations", True)
    request.addfinalizer(lambda: jax.config.update("jax_disable_most_optimizations", False))
    exec("\n".join(lines[2:]), names)
    error, here = names["error"], names["here"]
    assert 0 < error(here) < 0.03
    # thighs that are too long, and steps so small that in most places no point changes limbs: what is chosen is held
    # fixed in a derivative, and where points change limbs depends on the processor's last digits
    right = []
    for size in (0.03, 0.05, 0.07, 0.09, 0.11):
        slope = jax.grad(error)(here | {"lengths.thigh": size})
        assert set(slope) == set(here)
        quotients = []
        for step in (2e-5, 5e-5, 1e-4):
            ahead, behind = (float(error(here | {"lengths.thigh": size + d})) for d in (step, -step))
            quotients.append((ahead - behind) / (2 * step))
        right.append(any(float(slope["lengths.thigh"]) == pytest.approx(q, rel=0.05) for q in quotients))
    assert sum(right) >= 2, right
    assert float(error(here | {"lengths.thigh": 0.1})) > 1.3 * float(error(here))
    with pytest.raises(ValueError, match="lenghts"):
        names["vj"].solved({"lenghts.thigh": 0.0}, names["problem"])
