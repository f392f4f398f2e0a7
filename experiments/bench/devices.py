"""The step on all of JAX's devices, thousands of streams at once: python -m experiments.bench.devices [WORK.npz]

The work of same_work.py, for GPUs: every stream has its own copy of the points, elsewhere in the room, so that nothing
is shared; limbs of all streams are compared after the last frame with the same program's on the processor and with C's,
and two runs with each other, bit by bit. Beside the speed: XLA's count of operations and of bytes between memory and
kernels, and what share of `--tflops` and `--tbs` they make.
"""

import json
import time
from itertools import product
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from tqdm import tqdm

from experiments.bench.peers import c_step, library
from experiments.bench.peers.library import Solver
from experiments.bench.replay_speed import machine
from experiments.bench.work import STEPS, Work, from_demo, load
from experiments.common import table, write
from voodoo_jax.compile.xla_options import quick
from voodoo_jax.geometry.rigid import Poses

HEAD = (
    "solver", "points", "streams", "best, frames/s", "median", "limbs from the processor's, mm", "from C's, mm",
    "reruns",
    "Mflop a frame", "MB a frame", "of the devices' flop/s", "of their bytes/s", "compile, s",
)  # fmt: skip


def measure(work: Work, points: int, solver: Solver, streams: int, rounds: int, tflops: float, tbs: float) -> list[str]:
    """A row of the table."""
    devices = jax.devices()
    mesh, spec = Mesh(np.array(devices), ("stream",)), PartitionSpec("stream")
    common = library.body_of(work), library.links_of(work), library.options(solver, points)

    def here(common: tuple, starts: Poses, clouds: jax.Array) -> Poses:
        body, links, icp = common
        return jax.vmap(lambda start, cloud: library.track(body, links, icp, start, cloud))(starts, clouds)

    def given(offset):
        start = library.start_of(work)
        moved = lambda o: (Poses(start.rotation, start.translation + o), frames + o[:, None])  # noqa: E731
        return jax.vmap(moved)(offset)

    frames = jnp.asarray(work.frames(points))
    offset = np.random.default_rng(0).uniform(-1, 1, (streams, 3)).astype(np.float32)
    offset[0] = 0.0
    sharding = NamedSharding(mesh, spec)
    own = jax.jit(given, out_shardings=sharding)(jax.device_put(offset, sharding))
    args = jax.block_until_ready((common, *own))
    began = time.perf_counter()
    sharded = jax.shard_map(here, mesh=mesh, in_specs=(PartitionSpec(), spec, spec), out_specs=spec, check_vma=False)
    program = jax.jit(sharded, compiler_options=quick()).lower(*args).compile()
    compiling = time.perf_counter() - began
    first = jax.tree.map(np.asarray, program(*args))  # does not count
    seconds, same, found = [], True, first
    for _ in range(rounds):
        began = time.perf_counter()
        again = jax.block_until_ready(program(*args))
        seconds.append(time.perf_counter() - began)
        found = jax.tree.map(np.asarray, again)
        same &= all(np.array_equal(a, b) for a, b in zip(found, first))
    best, median = min(seconds), float(np.median(seconds))
    total, usual = streams * len(frames), _c(work, points) if solver == "per_limb" else None
    apart = lambda other: f"{1e3 * np.abs(found.translation - offset[:, None] - other).max():.2f}"  # noqa: E731
    cost = program.cost_analysis() or {}
    # XLA counts the loops' body once, and one device's part: one step of its streams
    share = STEPS * len(devices) / streams
    flop, size = (share * cost.get(name, float("nan")) for name in ("flops", "bytes accessed"))
    of = [f"{100 * each * total / best / most / 1e12:.0f} %" if most > 0 else ""
          for each, most in ((flop, tflops), (size, tbs))]  # fmt: skip
    return [solver, f"{points}", f"{streams}", f"{total / best:.0f}", f"{total / median:.0f}",
            apart(_processor(work, points, solver)), "" if usual is None else apart(usual),
            "same bits" if same else "differ", f"{flop / 1e6:.1f}", f"{size / 1e6:.2f}", *of,
            f"{compiling:.1f}"]  # fmt: skip


def _processor(work: Work, points: int, solver: Solver) -> np.ndarray:
    """Where the same program on the processor has the limbs of a stream after the last frame, [limb, 3] metres."""
    with jax.default_device(jax.devices("cpu")[0]):
        given = library.body_of(work), library.links_of(work), library.options(solver, points)
        return np.asarray(jax.jit(library.track)(*given, library.start_of(work), work.frames(points)).translation)


def _c(work: Work, points: int) -> np.ndarray | None:
    """Where C has the limbs after the last frame, [limb, 3] metres; None: it cannot be compiled here."""
    try:
        return c_step.build(work, points)()[1]
    except ImportError:
        return None


def main(
    work: tyro.conf.Positional[Path | None] = None,
    points: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N...")] = (1000, 2000),
    streams: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N...")] = (1, 64, 1024, 4096),
    solvers: Annotated[tuple[Solver, ...], tyro.conf.arg(metavar="NAME...")] = ("per_limb", "coupled"),
    rounds: int = 5,
    tflops: float = 0.0,
    tbs: float = 0.0,
    out: Path = Path(__file__).parent / "out",
) -> None:
    """Prints a table and writes devices.md and devices.json.

    Args:
        work: arrays of the work; none: made from the demo recording.
        points: points per frame.
        streams: recordings at once, a multiple of the number of devices.
        solvers: per_limb (the work as C does it), coupled.
        rounds: runs of each program after the first.
        tflops: what all devices together can do at most, 10^12 float32 operations a second; an H200: 67.
        tbs: what their memory can, 10^12 bytes a second; an H200: 4.8; an H100: 3.35.
        out: folder for results.
    """
    info = machine() | {"devices": [device.device_kind for device in jax.devices()]}
    given = load(work) if work else from_demo(points)
    cases = tqdm(list(product(points, solvers, streams)), leave=False, disable=None)
    rows = [measure(given, n, solver, s, rounds, tflops, tbs) for n, solver, s in cases]
    out.mkdir(parents=True, exist_ok=True)
    write(out, "devices", table(list(HEAD), rows) + f"\n\n{', '.join(f'{k} {v}' for k, v in info.items())}.")
    (out / "devices.json").write_text(json.dumps({"machine": info, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
