"""Tracks as named columns, one value for each frame: what CSV files and data frames hold."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from voodoo_jax.records.tracks import Tracks


def track_columns(tracks: "Tracks") -> dict[str, np.ndarray]:
    """Columns by name, which says the unit: stamps, `tracked`, residual, joint centres (fixed frame), their confidence,
    joint angles. NaN where there is nothing."""
    stamps = np.asarray(tracks.time_ns, np.int64)
    columns: dict[str, np.ndarray] = {
        "time_ns": stamps,
        "time_s": (stamps - stamps[:1]) / 1e9,
        "tracked": np.asarray(tracks.tracked),
        "residual_m": np.asarray(tracks.evidence.residual, float),
    }
    names = tracks.joint_names
    for i, name in enumerate(names):
        columns |= {f"{name}_{axis}_m": tracks.joints[:, i, k].astype(float) for k, axis in enumerate("xyz")}
    sure = tracks.joint_confidence
    for i, name in enumerate(names):
        nothing = np.full(len(stamps), np.nan)
        columns[f"{name}_confidence"] = nothing if sure is None else sure[:, i].astype(float)
    angles = tracks.angles()
    return columns | {f"{name}_deg": values for name, values in zip(angles.columns, np.degrees(angles.table).T)}
