"""The same work for every contender: ten limbs, nine joints, 80 frames of points on a person.

One frame is 6 steps of: each point to its nearest limb within 15 cm, closest point on the side of the limb's elliptic
frustum (no end caps, the point's polar angle is kept), bands with r = 0.5, absolute orientation of all limbs.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

STEPS = 6
REACH = 0.15  # metres; a point farther from every limb has no pair
RATIO = 0.5  # r of the bands
LEAST = 30.0  # points: what the bands of a limb with fewer refer to


@dataclass(frozen=True)
class Work:
    """Arrays of the work, float32 and int32; metres."""

    size: np.ndarray  # [limb, 5] a0, b0 (bottom semi-axes), a1, b1 (top), length
    R: np.ndarray  # [limb, 3, 3] T_world_limb before the first frame
    t: np.ndarray  # [limb, 3]
    parent: np.ndarray  # [joint] limb
    child: np.ndarray  # [joint] limb
    pa: np.ndarray  # [joint, 4, 3] ends of the bands on the parent, its frame
    pc: np.ndarray  # [joint, 4, 3] on the child
    bm: np.ndarray  # [joint, 4] 1: the band is there
    w: np.ndarray  # [joint] weight of the joint
    points: dict[int, np.ndarray]  # number of points -> [frame, 3, point] world frame

    @property
    def band_weight(self) -> np.ndarray:
        """Weights of the bands [joint, 4]; a joint's sum to its weight."""
        return self.w[:, None] * self.bm / self.bm.sum(1, keepdims=True)

    def frames(self, points: int) -> np.ndarray:
        """Points [frame, 3, point], float32."""
        if points not in self.points:
            raise SystemExit(f"the work has {sorted(self.points)} points, not {points}")
        return np.ascontiguousarray(self.points[points], np.float32)


def with_limbs(work: Work, count: int) -> Work:
    """The work with fewer limbs, or with limbs again and again beside themselves; the points stay."""
    here = len(work.t)
    copies = -(-count // here)
    keep = [j for j in range(len(work.parent)) if max(work.parent[j], work.child[j]) < min(count, here)]
    again = lambda a: np.concatenate([a] * copies)[:count]  # noqa: E731
    joints = lambda a: np.concatenate([a[keep]] * copies)  # noqa: E731
    shift = np.repeat(np.arange(copies) * here, len(keep)).astype(np.int32)
    aside = np.repeat(np.arange(copies), here)[:count, None] * np.array([0.05, 0, 0], np.float32)
    return replace(
        work, size=again(work.size), R=again(work.R), t=again(work.t) + aside, parent=joints(work.parent) + shift,
        child=joints(work.child) + shift, pa=joints(work.pa), pc=joints(work.pc), bm=joints(work.bm), w=joints(work.w),
    )  # fmt: skip


def save(work: Work, path: Path) -> None:
    """Writes the work; `load` reads it."""
    arrays = {k: v for k, v in vars(work).items() if k != "points"}
    arrays |= {f"P{n}": p for n, p in work.points.items()}
    np.savez(path, allow_pickle=False, **arrays)


def load(path: Path) -> Work:
    """Work from a file: arrays named as the fields, and P500, P1000, ... [frame, 3, point]."""
    with np.load(path, allow_pickle=False) as file:
        data = dict(file)
    points = {int(k[1:]): v for k, v in data.items() if k[0] == "P" and k[1:].isdigit()}
    fields = [k for k in Work.__dataclass_fields__ if k != "points"]
    return Work(**{k: data[k] for k in fields}, points=points)


def from_demo(counts: tuple[int, ...] = (500, 1000, 2000, 4000), frames: int = 80) -> Work:
    """Equal work for everybody: the person of the demo recording, with the papers' body of ten limbs."""
    from experiments.bench.replay_speed import resample
    from experiments.common import DEMO, load_log, log_files
    from voodoo_jax.config.options import Settings
    from voodoo_jax.geometry.rigid import matrix
    from voodoo_jax.model.body import band_mask, bands
    from voodoo_jax.model.body_file import load_body

    body = load_body("human10")
    log = load_log(log_files(DEMO)[0], body, Settings())
    tracks = log.track(body, Settings())
    first = int(np.argmax(tracks.tracked))
    people = [p for p in log.people[first:] if len(p.points) > 0][:frames]
    links = bands(tracks.body)
    floats = {
        "size": tracks.body.sizes, "R": matrix(tracks.rotation[first]), "t": tracks.translation[first],
        "pa": links.first_points, "pc": links.second_points, "bm": band_mask(tracks.body.axes),
        "w": tracks.body.weights,
    }  # fmt: skip
    return Work(
        **{k: np.asarray(v, np.float32) for k, v in floats.items()},
        parent=np.asarray(links.first, np.int32),
        child=np.asarray(links.second, np.int32),
        points={n: np.stack([resample(p, n).points.T for p in people]).astype(np.float32) for n in counts},
    )
