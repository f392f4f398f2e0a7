"""The settings after a fit: with the fitted options of the solve and weights of features."""

from dataclasses import replace

import numpy as np

from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.parameters import SETTINGS, TRACK, Changes
from voodoo_jax.model.body import Topology
from voodoo_jax.solve.names import FeatureNames


def tuned_settings(settings: Settings, topology: Topology, by: Changes, features: tuple[str, ...]) -> Settings:
    """The settings with the changes of a fit; all other settings stay.

    **Arguments:** `by` the changes (see fitting.parameters); `features` names of the features in `by.features`.
    """
    factors = dict(zip(SETTINGS, np.exp(np.asarray(by.settings, np.float64)).tolist()))
    solve = {k: getattr(settings.solve, k) * f for k, f in factors.items() if f != 1}
    over_time = dict(zip(TRACK, np.exp(np.asarray(by.track, np.float64)).tolist()))
    track = {k: getattr(settings.track, k) * f for k, f in over_time.items() if f != 1}
    changed = [(n, f) for n, f in zip(features, np.exp(np.asarray(by.features, np.float64)).tolist()) if f != 1]
    table, weights = FeatureNames(topology, settings.features), settings.features.weights
    if changed:
        of = table.weights | {table.plain(n): table.weights.get(table.plain(n), table.weight) * f for n, f in changed}
        weights = tuple(f"{name}={value:.4g}" for name, value in of.items())
    return replace(
        settings, solve=replace(settings.solve, **solve), track=replace(settings.track, **track),
        features=replace(settings.features, weights=weights),
    )  # fmt: skip
