"""Executables that are kept: found without a trace, the same to the last bit, never in the way when they do not fit."""

import os
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from voodoo_jax.compile.executable import program, seconds_of_waiting
from voodoo_jax.compile.xla_options import OPTIONS, quick
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.model.body_file import human, load_body

CHILD = """
import sys
import jax.numpy as jnp, numpy as np
from voodoo_jax.compile.cache_dir import use_compile_cache
from voodoo_jax.compile.executable import program
traced = 0

@program
def solved(way, given):
    global traced
    traced += 1
    matrix = given["m"] @ given["m"].T + jnp.eye(len(given["m"]))
    return {"x": jnp.linalg.solve(matrix, given["b"]) if way == "solve" else matrix, "low": jnp.linalg.cholesky(matrix)}

print(use_compile_cache(sys.argv[1]))
rng = np.random.default_rng(0)
out = solved(sys.argv[2], {"m": rng.random((6, 4)), "b": jnp.asarray(rng.random(6))})
print(traced, np.asarray(out["x"]).tobytes().hex(), np.asarray(out["low"]).tobytes().hex())
"""


def start(folder: Path, way: str = "solve", code: str = CHILD, flags: str | None = None) -> subprocess.Popen:
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    env |= {} if flags is None else {"XLA_FLAGS": flags}
    command = [sys.executable, "-c", code, str(folder), way]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def answer(child: subprocess.Popen) -> list[str]:
    out, err = child.communicate(timeout=120)
    assert child.returncode == 0, err
    return out.split()


def entries(folder: Path) -> list[Path]:
    return [p for p in folder.glob("*/program-*") if p.is_file()]


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> tuple[Path, list[str], list[str]]:
    """A folder that two processes have filled at the same time, and what they said."""
    folder = tmp_path_factory.mktemp("cache")
    children = [start(folder) for _ in range(2)]
    return folder, answer(children[0]), answer(children[1])


def test_two_at_once_trace_it_once(first):
    folder, one, two = first
    assert sorted([one[0], two[0]]) == ["0", "1"] and one[1:] == two[1:]
    assert len(entries(folder)) == 2 and not list(folder.glob("*/lock-*"))


def test_without_a_cache_the_same_to_the_last_bit(first):
    assert answer(start(Path("off"), code=CHILD.replace("use_compile_cache(sys.argv[1])", "''")))[1:] == first[1][1:]


def test_another_static_argument_is_another_program(first):
    traced, x, low = answer(start(first[0], "matrix"))
    assert traced == "1" and x != first[1][1] and low == first[1][2]


def test_flags_that_programs_settle_themselves_make_no_others(first):
    """So the tests' programs are those of processes without flags; any other flag may change what is compiled."""
    for flags in ("", "--xla_cpu_use_fusion_emitters=true"):
        assert answer(start(first[0], flags=flags)) == ["0", *first[1][1:]]
    assert answer(start(first[0], flags="--xla_cpu_enable_fast_min_max=true"))[0] == "1"


def test_spoiled_entries_are_made_anew(first):
    folder, said, _ = first
    for entry in entries(folder):
        entry.write_bytes(entry.read_bytes()[:-20])
    for traced in ("1", "0"):
        assert answer(start(folder)) == [traced, *said[1:]]


@program
def highest(body: Body, pick: str):
    return jnp.max(joint_centres(body, body.rest)[:, "xyz".index(pick)])


def test_in_one_process():
    body, arm = human(), load_body("arm")
    for each, pick in ((body, "z"), (body, "x"), (arm, "z")):
        assert float(highest(each, pick)) == float(highest.__wrapped__(each, pick))
    assert len(highest.ready) == 3
    assert float(highest(eqx.tree_at(lambda b: b.centres, body, 2 * body.centres), "z")) > float(highest(body, "z"))
    assert len(highest.ready) == 3


def test_derivatives_and_maps_go_through():
    body = human()
    height = lambda shift: highest(eqx.tree_at(lambda b: b.rest.translation, body, body.rest.translation + shift), "z")  # noqa: E731
    assert np.isclose(float(jax.grad(lambda s: height(jnp.array([0.0, 0.0, s])))(0.0)), 1.0)
    many = jax.vmap(lambda s: height(jnp.array([0.0, 0.0, s])))(jnp.arange(3.0))
    assert np.allclose(np.diff(many), 1.0)


@program
def slowly(x):
    time.sleep(0.3)  # to trace it
    return x + 1


def test_two_threads_make_it_once_and_both_have_waited_for_it():
    waited = []

    def ask() -> None:
        before = seconds_of_waiting()
        slowly(jnp.arange(3))
        slowly(jnp.arange(3))
        waited.append(seconds_of_waiting() - before)

    threads = [Thread(target=ask) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(slowly.ready) == 1 and min(waited) > 0.1
    before = seconds_of_waiting()
    slowly(jnp.arange(3))
    assert seconds_of_waiting() - before < 0.1


def test_options_that_this_xla_does_not_know_are_left_out(monkeypatch):
    known = quick()
    assert known == OPTIONS["cpu"]  # of the version that is locked
    monkeypatch.setitem(OPTIONS["cpu"], "xla_of_another_age", True)
    quick.cache_clear()
    try:
        assert quick() == known
    finally:
        quick.cache_clear()
