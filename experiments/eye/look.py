"""The eye on one frame: one column, or all columns of a scene.

Points in a frame with z up, the floor near z = 0, and where the sensor is.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from experiments.eye.data import PARTS
from voodoo_jax.kernels.eye import HIGH, JOINTS, forward, named
from voodoo_jax.trackers.shared.eye import FEATURES, RADIUS, TOKENS, thinned, tokens, view
from voodoo_jax.trackers.shared.eye import weights as weights_in

CELL, NEAR, APART, FLOOR = 0.3, 0.35, 0.45, 0.05  # metres
UP = np.array([0, 0, 1.0])
ENOUGH, COLUMNS, BATCH = 15, 48, 8  # thinned points in a column, columns that are looked at, at once
FULL = 40.0  # points of a body that make somebody as likely as the eye says


class Seen(NamedTuple):
    """What the eye says of a column."""

    joints: np.ndarray  # [14, 3] metres, in the frame of the points
    spread: np.ndarray  # [14] its own error, metres
    odds: float  # logarithm, that left and right are as said
    person: float  # logarithm of the odds that somebody is there
    body: np.ndarray  # [point] probability to be of the body
    near: np.ndarray  # [point] which points those are


@cache
def _program(weights: Path):
    params = weights_in(weights)

    def told(tok, sensor):
        out, odds = named(forward(params, tok, sensor))
        return out._asdict() | dict(odds=odds)

    run = jax.jit(jax.vmap(told))
    return lambda tok, sensor: {k: np.asarray(v) for k, v in run(tok, sensor).items()}


def look(weights: Path, points: np.ndarray, sensor: np.ndarray, columns: np.ndarray) -> list[Seen]:
    """What is in columns [column, 2]."""
    found, run = [], _program(weights)
    for at in range(0, len(columns), BATCH):
        some = columns[at : at + BATCH]
        many = 1 if len(columns) == 1 else BATCH
        tok = np.zeros((many, TOKENS, FEATURES), np.float32)
        far, kept = np.zeros((many, 2), np.float32), []
        for row, (x, y) in enumerate(some):
            near = np.flatnonzero((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2 < RADIUS**2)
            rel, turn = points[near] - [x, y, 0], view(sensor - [x, y, 0], UP)
            tok[row], token = tokens(rel @ turn.T)
            far[row] = np.linalg.norm(sensor[:2] - [x, y]), sensor[2]
            kept.append((near[token >= 0], token[token >= 0], turn))
        out = run(tok, far)
        for row, (near, token, turn) in enumerate(kept):
            part = np.exp(out["part"][row] - out["part"][row].max(-1, keepdims=True))
            body = (part[:, : len(PARTS)].sum(-1) / part.sum(-1))[token]
            joints = out["joints"][row] @ turn + [*some[row], 0]
            spread = np.exp(out["spread"][row])
            found.append(Seen(joints, spread, float(out["odds"][row]), float(out["person"][row]), body, near))
    return found


def centred(weights: Path, points: np.ndarray, sensor: np.ndarray, column: np.ndarray, times: int = 2) -> Seen:
    """The column moved to the middle of what is in it."""
    for _ in range(times):
        seen = look(weights, points, sensor, column[None])[0]
        moved = hips(seen.joints)[:2]
        if np.linalg.norm(moved - column) < 0.05:
            break
        column = moved
    return seen  # pyright: ignore[reportPossiblyUnbound]


def hips(joints: np.ndarray) -> np.ndarray:
    return (joints[..., JOINTS.index("l_hip"), :] + joints[..., JOINTS.index("r_hip"), :]) / 2


def people(weights: Path, points: np.ndarray, sensor: np.ndarray, most: int = 1, least: float = 0.0) -> list[Seen]:
    """Whoever is in a scene, from scratch: all columns, the surest first; `least` logarithm of the odds."""
    points = thinned(points[(points[:, 2] > FLOOR) & (points[:, 2] < HIGH)].astype(float))[0]
    cells, count = np.unique(np.floor(points[:, :2] / CELL).astype(int), axis=0, return_counts=True)
    middles = []
    for cell in cells[np.argsort(-count)]:
        near = np.linalg.norm(points[:, :2] - (cell + 0.5) * CELL, axis=1) < NEAR
        middle = points[near, :2].mean(0) if near.sum() >= ENOUGH else None
        if middle is not None and all(np.linalg.norm(middle - m) > 0.25 for m in middles):
            middles.append(middle)
    if not middles:
        return []
    all_seen = look(weights, points, sensor, np.array(middles[:COLUMNS]))
    rank = [s.person + np.log(min(1.0, max(s.body.sum(), 1e-3) / FULL)) for s in all_seen]
    found: list[Seen] = []
    for k in np.argsort(rank)[::-1]:
        if rank[k] < least or len(found) >= most:
            break
        if any(np.linalg.norm(hips(all_seen[k].joints)[:2] - hips(f.joints)[:2]) < APART for f in found):
            continue
        found.append(centred(weights, points, sensor, hips(all_seen[k].joints)[:2]))
    return found
