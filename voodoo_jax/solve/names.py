"""Names of features and of parts in a log, looked up as rows of the body's named points and limbs."""

import numpy as np

from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.kernels.correspondences import FREE, ON_BODY
from voodoo_jax.model.body import Topology
from voodoo_jax.model.joint_names import LIMB_WORDS, row_of
from voodoo_jax.model.marker_sets import PLUG_IN_GAIT, V1_NAMES, plain_name
from voodoo_jax.records.observation import BodyObservation


class FeatureNames:
    """The body's point for each name in a log, and its weight."""

    def __init__(self, topology: Topology, settings: FeatureSettings):
        points = {name: i for i, name in enumerate((*topology.sites, *topology.centres))}
        # a site and a joint centre of one name: the centre, which tracks report
        alias = PLUG_IN_GAIT | check_pairs("features.names", settings.names)
        self.rows: dict[str, tuple[int, ...]] = {name: (row,) for name, row in points.items()}
        for name, targets in alias.items():
            known = tuple(
                row for target in targets.split("|") if (row := self._row(points, topology, target)) is not None
            )
            if known:
                self.rows[name] = known
        weights = check_pairs("features.weights", settings.weights)
        self.weights = {self.plain(name): float(value) for name, value in weights.items()}
        self.weight = settings.weight

    @staticmethod
    def _row(points: dict[str, int], topology: Topology, target: str) -> int | None:
        """Row of a named point, or of a joint centre under a name of another convention."""
        if target in points:
            return points[target]
        row = row_of(topology.centres, target)
        return None if row is None else len(topology.sites) + row

    def choices(self, names: set[str]) -> int:
        """Largest number of body points that one of the names may stand for."""
        return max((len(self.look_up(n) or ()) for n in names), default=1) or 1

    def look_up(self, name: str) -> tuple[int, ...] | None:
        """Rows of kernels.landmarks.named_points that a name may stand for; None: the body has no such name."""
        return self.rows.get(self.plain(name))

    def plain(self, name: str) -> str:
        """The name under which a feature is looked up, for any standard and prefix."""
        if name in self.rows:
            return name
        name = V1_NAMES.get(name, name)
        return name if name in self.rows else plain_name(name)

    def find(self, name: str) -> tuple[tuple[int, ...], float] | None:
        """Rows of kernels.landmarks.named_points that the feature may be, and its weight; None for a name that the body
        does not have."""
        name = self.plain(name)
        if name not in self.rows:
            return None
        return self.rows[name], self.weights.get(name, self.weight)


class PartNames:
    """Limb of each part that a segmentation of the log names."""

    def __init__(self, topology: Topology):
        self.names = topology.limbs
        self.unknown: set[str] = set()  # parts that the body does not have: their points count as on the body

    def rows(self, frame: BodyObservation) -> np.ndarray:
        """Limb, ON_BODY or FREE of each point [point], int32."""
        if frame.part is None:
            return np.full(len(frame.points), FREE, np.int32)
        limbs = [None if p == "body" else row_of(self.names, p, LIMB_WORDS) for p in frame.parts]
        self.unknown |= {p for p, limb in zip(frame.parts, limbs) if p != "body" and limb is None}
        table = np.array([*(ON_BODY if limb is None else limb for limb in limbs), FREE], np.int32)
        return table[frame.part]  # -1, free, is the last entry
