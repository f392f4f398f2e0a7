"""Open3D's point-to-point ICP limb by limb. Less than the work: points are assigned before, and there are no bands."""

from collections.abc import Callable

import numpy as np

from experiments.bench.peers.assigned import run_by_limb, surface
from experiments.bench.work import REACH, STEPS, Work


def build(work: Work, points: int) -> Callable:
    """All frames; poses after the last."""
    import open3d  # pyright: ignore[reportMissingImports]

    icp, vectors = open3d.pipelines.registration, open3d.utility.Vector3dVector
    limbs = [open3d.geometry.PointCloud(vectors(surface(size))) for size in work.size.astype(float)]
    method = icp.TransformationEstimationPointToPoint()
    rule = icp.ICPConvergenceCriteria(relative_fitness=0.0, relative_rmse=0.0, max_iteration=STEPS)

    def align(limb: int, seen: np.ndarray, start: np.ndarray) -> np.ndarray:
        cloud = open3d.geometry.PointCloud(vectors(seen))
        return icp.registration_icp(cloud, limbs[limb], REACH, start, method, rule).transformation

    return run_by_limb(work, points, align)
