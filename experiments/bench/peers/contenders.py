"""Who runs, how, and in which processes."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Contender:
    """One way to do the work."""

    label: str
    module: str  # in experiments.bench.peers
    options: dict[str, object] = field(default_factory=dict)  # of its build()
    cores: int = 1  # processes at a time, each on a core of its own
    pinned: bool = True  # False: one process that may use all cores
    same: bool = True  # False: not the whole step, or other poses: not compared

    @property
    def streams(self) -> int:
        """Recordings that one process tracks at once."""
        return int(str(self.options.get("streams", 1)))


CONTENDERS = {
    "c": Contender("C, dense, one core", "c_step"),
    "c_both": Contender("C, dense, both cores", "c_step", cores=2),
    "library": Contender("voodoo_jax, limb by limb, one stream, one core", "library"),
    "library_batch": Contender("voodoo_jax, limb by limb, 16 streams on each of both cores", "library",
                               {"streams": 16}, cores=2),
    "coupled": Contender("voodoo_jax, coupled, one stream, one core", "library", {"solver": "coupled"}, same=False),
    "coupled_batch": Contender("voodoo_jax, coupled, 16 streams on each of both cores", "library",
                               {"solver": "coupled", "streams": 16}, cores=2, same=False),
    "numpy": Contender("NumPy, one core (a second one gains nothing)", "numpy_step"),
    "numba_plain": Contender("Numba, point by point, 2 threads", "numba_step", {"by_point": True}, pinned=False),
    "numba": Contender("Numba, arrays of points, 2 threads", "numba_step", pinned=False),
    "numba_both": Contender("Numba, arrays of points, a recording on each of both cores", "numba_step",
                            {"threads": 1}, cores=2),
    "open3d": Contender("Open3D ICP, points assigned before, no bands", "open3d_icp", pinned=False, same=False),
    "small_gicp": Contender("small_gicp, 2 threads, the same", "gicp", pinned=False, same=False),
}  # fmt: skip
