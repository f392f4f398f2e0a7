"""Assigns detected features, such as faces and hands, to one person each. Host side.

A detector names two faces "face" alike. A 3D feature is assigned to the person with the nearest points, a line of sight
to the first person along it.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Pairs, Rays
from voodoo_jax.records.subject import Subject

# metres from a person's points within which a line of sight meets them: a detector's error at 3 m. 0.067 and 0.15 give
# 2 and 9 of 550 features to another person (measured, experiments/numbers)
IN_ITS_WAY = 0.1


def with_own_features(subjects: list[Subject]) -> list[Subject]:
    """Each subject with only their own features of each frame; unchanged if these are all."""
    frames = [list(subject.frames) for subject in subjects]
    for at, seen in enumerate(zip(*frames)):
        if not (seen[0].rays.names or seen[0].pairs.names) or not any(len(f.points) for f in seen):
            continue
        of_pairs, of_rays = owners_of_pairs(seen[0].pairs, seen), owners_of_rays(seen[0].rays, seen)
        for k, own in enumerate(seen):
            frames[k][at] = replace(own, pairs=_some(own.pairs, of_pairs == k), rays=_some(own.rays, of_rays == k))
    return [replace(s, frames=own) for s, own in zip(subjects, frames)]


def owners_of_pairs(pairs: Pairs, seen: tuple[BodyObservation, ...]) -> Int[np.ndarray, " pair"]:
    """The person with the nearest points, for each feature."""
    places = np.asarray(pairs.points, float).reshape(-1, 3)
    return np.argmin([[_least(np.linalg.norm(f.points - p, axis=1)) for p in places] for f in seen], 0).astype(int)


def owners_of_rays(rays: Rays, seen: tuple[BodyObservation, ...]) -> Int[np.ndarray, " ray"]:
    """The first person along each line of sight; if it meets no person, the one whose points it passes most closely."""
    return np.argmin([_in_the_way(rays, f) for f in seen], 0).astype(int)


def _in_the_way(rays: Rays, seen: BodyObservation) -> Float[np.ndarray, " ray"]:
    """Distance of a person along each line, metres; for people beside the line, its distance from them, ranked after
    all others."""
    out = []
    for origin, direction in zip(np.asarray(rays.origins, float), np.asarray(rays.directions, float)):
        to = seen.points - origin
        along = to @ direction
        aside = np.linalg.norm(to - along[:, None] * direction, axis=1)
        hit = (aside < IN_ITS_WAY) & (along > 0)
        out.append(_least(along[hit]) if hit.any() else 1e6 + _least(aside[along > 0]))
    return np.array(out)


def _least(values: np.ndarray) -> float:
    return float(np.min(values, initial=1e9))


def _some(features, keep: np.ndarray):
    """Pairs or rays, those to keep; the same object where that is all of them."""
    if keep.all():
        return features
    arrays = {k: v[keep] for k, v in vars(features).items() if k != "names" and v is not None}  # weights may be None
    return replace(features, names=tuple(n for n, k in zip(features.names, keep) if k), **arrays)
