"""The settings after a fit: what was found of the solve's options and of the features' weights."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from voodoo_jax.settings import FeatureSettings, Settings, check_pairs


def tuned_settings(settings: Settings, found: Mapping[str, float]) -> Settings:
    """The settings changed by what a fit found.

    **Arguments:** `found` parameters by name (see fit_parameters), logarithms of factors; those of the body and its
    bands are passed over: they are in the body file.
    """
    solve, features = settings.solve, settings.features
    for name, value in found.items():
        stage, _, key = name.partition(".")
        if stage == "solve":
            solve = replace(solve, **{key: getattr(solve, key) * float(np.exp(value))})
        elif stage == "features":
            features = _reweighted(features, key.removesuffix(".weight"), float(np.exp(value)))
    return replace(settings, solve=solve, features=features)


def _reweighted(features: FeatureSettings, name: str, factor: float) -> FeatureSettings:
    weights = {k: float(v) for k, v in check_pairs("features.weights", features.weights, numbers=True).items()}
    weights[name] = weights.get(name, features.weight) * factor
    return replace(features, weights=tuple(f"{k}={v:.4g}" for k, v in weights.items()))
