"""What a coverage-guided fuzzer calls: python -m experiments.fuzz.atheris_target [DOOR] [CORPUS] [options of libFuzzer]

DOOR is log (the default), convert, body, live or results. Begins with sound and damaged inputs of experiments/fuzz in
the folder CORPUS, if that is empty. Anything but a result or a sentence is a find, and so is what takes over a minute
or 2 GB. Parsers of foreign files run here, without their guard, so that the fuzzer sees where they go.
"""

import json
import os
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

MISSING = 'The fuzzer atheris is not installed: pip install "voodoo_jax[fuzz]" (Linux, CPython 3.11 to 3.14).'
OPTIONS = ("-timeout=60", "-rss_limit_mb=2048")
ENDINGS = {  # of the files at each door
    "convert": ("bag", "db3", "json", "c3d", "trc", "mkv"), "body": ("gltf", "glb", "urdf"), "live": ("json", "mcap"),
    "results": ("npz", "jsonl"),
}  # fmt: skip
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


def try_door(door: str, data: bytes) -> str:
    """Tries a file at another door, of a kind that its first byte says; why it was refused. Raises what nobody
    expected."""
    import voodoo_jax.io.convert.sources
    import voodoo_jax.model.foreign.sources
    from experiments.fuzz.doors import TRY
    from experiments.fuzz.sound_files import Sound
    from voodoo_jax.storage import guard

    def here(task: str, arguments: Any, readable: Any, room: guard.Room, take: Any, imports: Any = ()) -> list[str]:
        return guard.unguarded(task, arguments, room, take)

    module: Any
    for module in (voodoo_jax.io.convert.sources, voodoo_jax.model.foreign.sources):
        module.guarded = here
    name = f"a.{ENDINGS[door][data[0] % len(ENDINGS[door])]}" if data else "a"
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / name, Path(folder) / "out"
        out.mkdir()
        path.write_bytes(data[1:])
        return TRY[door](path, out, Sound(name, name, {}))[0]


def begin_at(door: str, corpus: Path) -> None:
    """Fills an empty folder with a door's sound inputs."""
    from experiments.fuzz.sound_files import sound_files

    corpus.mkdir(parents=True, exist_ok=True)
    if any(corpus.iterdir()):
        return
    with tempfile.TemporaryDirectory() as folder:
        for number, one in enumerate(sound_files(door, Path(folder) / "sound")):
            ending = one.main.rpartition(".")[2]
            if ending in ENDINGS[door]:
                content = one.files[one.main]
                text = content if isinstance(content, (bytes, str)) else json.dumps(content)
                data = text if isinstance(text, bytes) else text.encode()
                (corpus / f"{number:04d}").write_bytes(bytes([ENDINGS[door].index(ending)]) + data)


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
    with atheris.instrument_imports(include=["voodoo_jax.io", "voodoo_jax.model.foreign", "mcap", "rosbags"]):
        import voodoo_jax.io.log_reader
        import voodoo_jax.model.foreign.skinned_mesh  # noqa: F401
    door = arguments.pop(0) if arguments[:1] and arguments[0] in ENDINGS else ""
    if arguments and not arguments[0].startswith("-"):
        begin_at(door, Path(arguments[0])) if door else begin(Path(arguments[0]))

    def target(data: bytes) -> None:
        try_door(door, data) if door else try_log(data)

    atheris.Setup([sys.argv[0], *OPTIONS, *arguments], target)
    atheris.Fuzz()


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    main(sys.argv[1:])
