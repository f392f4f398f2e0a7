"""Runtime checks of shapes and types in the whole package, and double precision for the tests that ask for it."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

import jax
import numpy as np
import platformdirs
import pytest
from jaxtyping import install_import_hook

# before any test module imports the package: a module that is already loaded would go unchecked
# tower: an int is welcome where a float is asked for (PEP 484), as for the type checker
install_import_hook(["voodoo_jax"], "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))")

from voodoo_jax.compile.cache_dir import link_all  # noqa: E402  not before the hook

# compiled in two thirds of the time, see compile/xla_options.py; whatever is compiled without its options, too
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

# Compiled programs are kept from one run of the tests to the next, under names that their content gives: to compile
# them takes most of a first run. The user's own compile cache stays as it is.
KEPT = Path(os.environ.get("VOODOO_JAX_COMPILE_CACHE") or platformdirs.user_cache_path("voodoo_jax_tests"))
MOST = 4_000_000_000  # bytes; when there are more all are forgotten
if "PYTEST_XDIST_WORKER" not in os.environ and KEPT.name == "voodoo_jax_tests" and KEPT.is_dir():
    if sum(file.stat().st_size for file in KEPT.rglob("*-cache")) > MOST:
        shutil.rmtree(KEPT, ignore_errors=True)
OF_JAX = KEPT / "of-jax"  # what jax itself keeps
for folder in (KEPT, OF_JAX):
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
os.environ["VOODOO_JAX_COMPILE_CACHE"] = str(KEPT)

# jax does not write at once: it has a folder of this process's own, which is not for child processes
OWN = None if jax.config.jax_compilation_cache_dir else Path(tempfile.mkdtemp(prefix="run-tests-"))
if OWN is not None:
    link_all(OF_JAX, OWN)
    atexit.register(shutil.rmtree, OWN, ignore_errors=True)
    jax.config.update("jax_compilation_cache_dir", str(OWN))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="2000 damaged logs, tracked too (half an hour)")


# a minute or more each, measured: begun first, or one process works on one of them at the end while the other waits
LONG = tuple(
    f"tests/{name}.py"
    for name in (
        "system/test_front_door", "system/test_same_bits", "system/test_notebooks", "trackers/flexible/test_tracker",
        "solve/test_gradients", "fitting/test_fit", "system/test_experiments", "markers/test_markers",
    )
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not item.nodeid.startswith(LONG))


@pytest.fixture
def rng(request) -> np.random.Generator:
    """Random numbers that depend on the test's name only: tests may be run alone or in any order."""
    return np.random.default_rng(list(request.node.nodeid.split("/")[-1].encode()))


@pytest.fixture
def x64():
    """float64 for this test; elsewhere the tests run in float32 as the product does (part of jit's cache key)."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def compiled_in_a_hurry():
    """For tests of small programs that are run once or twice: they take longer to compile than to run. Not for those of
    compile/executable.py, which other modules' tests would find so."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


MAPS = Path("/proc/self/maps")  # of this process's memory; Linux only


@pytest.fixture(autouse=True, scope="module")
def room_for_programs():
    """Forgets compiled programs where there are many: each maps memory anew, and past 65,530 maps a process dies. Gives
    those of jax to later runs, and to the other process of this one."""
    yield
    if OWN is not None:
        link_all(OWN, OF_JAX)
        link_all(OF_JAX, OWN)
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > 15_000:
        jax.clear_caches()
        from voodoo_jax.compile.executable import forget  # not before the hook

        forget()
