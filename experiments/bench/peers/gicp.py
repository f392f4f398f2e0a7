"""small_gicp's ICP limb by limb, trees of the limbs made beforehand. Less than the work: as for Open3D."""

from collections.abc import Callable

import numpy as np

from experiments.bench.peers.assigned import run_by_limb, surface
from experiments.bench.work import REACH, STEPS, Work

THREADS = 2


def build(work: Work, points: int) -> Callable:
    """All frames; poses after the last."""
    import small_gicp  # pyright: ignore[reportMissingImports]

    limbs = [small_gicp.PointCloud(surface(size)) for size in work.size.astype(float)]
    trees = [small_gicp.KdTree(limb) for limb in limbs]

    def align(limb: int, seen: np.ndarray, start: np.ndarray) -> np.ndarray:
        found = small_gicp.align(
            limbs[limb], small_gicp.PointCloud(seen), trees[limb], start, registration_type="ICP",
            max_correspondence_distance=REACH, num_threads=THREADS, max_iterations=STEPS,
            rotation_epsilon=0.0, translation_epsilon=0.0,
        )  # fmt: skip
        return found.T_target_source

    return run_by_limb(work, points, align)
