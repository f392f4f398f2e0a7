"""What a coverage-guided fuzzer calls: python -m experiments.fuzz.atheris_target [CORPUS] [options of libFuzzer]

Begins with sound and damaged logs of experiments/fuzz in the folder CORPUS, if that is empty. Anything but frames or a
LogError is a find, and so is what takes over a minute or 2 GB.
"""

import os
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

MISSING = 'The fuzzer atheris is not installed: pip install "voodoo_jax[fuzz]" (Linux, CPython 3.11 to 3.14).'
OPTIONS = ("-timeout=60", "-rss_limit_mb=2048")
SEEDS = 300  # inputs that the corpus begins with


def try_log(data: bytes) -> int:
    """Looks through a log and reads it; how many frames it gives, 0 for one that is refused. Raises what nobody
    expected, AssertionError for points that are not finite and for a refusal that does not name the file."""
    import numpy as np

    from voodoo_jax.io.container import LogError
    from voodoo_jax.io.log_reader import read_log, survey

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fuzz.mcap"
        path.write_bytes(data)
        try:
            survey(path)
            recording = read_log(path)
        except LogError as problem:
            assert "fuzz.mcap" in str(problem) or "The log" in str(problem), str(problem)
            return 0
    assert all(np.isfinite(frame.points).all() for frame in recording), "points are not finite"
    return len(recording)


def begin(corpus: Path) -> None:
    """Fills an empty folder with small inputs of all kinds."""
    from experiments.common import DEMO
    from experiments.fuzz.__main__ import chosen
    from experiments.fuzz.logs import base_of, written

    corpus.mkdir(parents=True, exist_ok=True)
    if any(corpus.iterdir()):
        return
    base = base_of(DEMO / "demo.mcap", 3)
    (corpus / "sound").write_bytes(written(base.log))
    for number, one in enumerate(chosen(base, 1, SEEDS)):
        if not one.large:
            (corpus / f"{number:04d}").write_bytes(one.make())


def main(arguments: list[str]) -> None:
    """Fuzzes until it is interrupted, or as libFuzzer's options say."""
    try:
        atheris: Any = import_module("atheris")  # its types are not known where it is not installed
    except ImportError:
        raise SystemExit(MISSING) from None
    with atheris.instrument_imports(include=["voodoo_jax.io", "mcap"]):
        import voodoo_jax.io.log_reader  # noqa: F401
    if arguments and not arguments[0].startswith("-"):
        begin(Path(arguments[0]))

    def target(data: bytes) -> None:
        try_log(data)

    atheris.Setup([sys.argv[0], *OPTIONS, *arguments], target)
    atheris.Fuzz()


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    main(sys.argv[1:])
