"""Trains the eye: python -m experiments.eye.train FOLDER WEIGHTS.npz MINUTES [BATCH [FIRST.npz]]

FOLDER has train*.npz and test*.npz of data.py; those that come while it trains are taken, too. It goes on from
WEIGHTS.state if that is there, or begins from FIRST.npz; the rate falls with the processor time used of MINUTES.
WEIGHTS.curve.json is the learning curve. On a GPU: MINUTES are then wall time, BATCH 256.
"""

import json
import pickle
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax  # pyright: ignore[reportMissingImports]

from experiments.eye import net
from experiments.eye.data import BACKGROUND, CLASSES, SHARD
from experiments.eye.voxels import tokens_and_labels
from voodoo_jax.kernels.eye import OTHER
from voodoo_jax.trackers.shared.eye import FEATURES, TOKENS, view, weights

RATE, WARM, KEEPS = 2e-3, 8_000, 0.998  # highest rate, crops until then, of the mean of weights
CHECKS, ENOUGH = 24, 25  # times that it is measured, points of a person that are somebody
SHARDS = 130  # in memory, at most
AGAIN = 0.5  # of the rate, from weights that are there
UP = np.array([0, 0, 1.0])


class Pool:
    """Crops in memory."""

    def __init__(self, folder: Path, stem: str):
        self.folder, self.stem, self.files, self.count = folder, stem, set(), 0
        self.arrays: dict[str, np.ndarray] = {}
        self.refresh()

    def refresh(self) -> None:
        for path in sorted(self.folder.glob(f"{self.stem}*.npz")):
            if path.name in self.files or len(self.files) >= SHARDS:
                continue
            try:
                with np.load(path) as file:
                    made = {k: file[k] for k in ("points", "labels", "joints", "sensor", "person", "kind")}
            except (OSError, ValueError, EOFError, KeyError):  # it is being written
                continue
            self.files.add(path.name)
            if not self.arrays:
                room = SHARDS * SHARD if self.stem == "train" else len(made["points"])
                self.arrays = {k: np.zeros((room, *v.shape[1:]), v.dtype) for k, v in made.items()}
            many = len(made["points"])
            for key, value in made.items():
                self.arrays[key][self.count : self.count + many] = value
            self.count += many

    def batch(self, index: np.ndarray, rng: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Tokens of crops; with `rng` seen anew: moved, mirrored, sized, thinned, the background cut away or not."""
        many = len(index)
        out = dict(
            tok=np.zeros((many, TOKENS, FEATURES), np.float32),
            hist=np.zeros((many, TOKENS, CLASSES), np.float32),
            joints=np.zeros((many, net.JOINT_COUNT, 3), np.float32), sensor=np.zeros((many, 2), np.float32),
            has=np.zeros(many, np.float32), care=np.zeros(many, np.float32),
        )  # fmt: skip
        for row, k in enumerate(index):
            labels = self.arrays["labels"][k]
            size = int(np.sum(labels < 255)) if labels[-1] == 255 else len(labels)
            points, labels = self.arrays["points"][k, :size].astype(float), labels[:size]
            joints, sensor = self.arrays["joints"][k].astype(float), self.arrays["sensor"][k].astype(float)
            person = bool(self.arrays["person"][k])
            if rng is not None:
                points, labels, joints, sensor = seen_anew(points, labels, joints, sensor, rng)
            turn = view(sensor, UP)
            out["tok"][row], out["hist"][row] = tokens_and_labels(points @ turn.T, labels)
            body = int(np.sum(labels < BACKGROUND))
            out["joints"][row] = joints @ turn.T
            out["sensor"][row] = np.hypot(sensor[0], sensor[1]), sensor[2]
            out["has"][row] = person and body >= ENOUGH
            out["care"][row] = not person or body >= 2 * ENOUGH
        return out


def seen_anew(points, labels, joints, sensor, rng: np.random.Generator):
    """A crop as another column, side or segmentation would have it."""
    move = np.array([*rng.normal(size=2) * 0.12, rng.normal() * 0.015])
    size = float(np.exp(rng.normal() * 0.04))
    points, joints, sensor = points * size - move, joints * size - move, sensor * size - [move[0], move[1], 0]
    way = rng.normal() * 0.15
    c, s = np.cos(way), np.sin(way)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    points, joints = points @ turn.T, joints @ turn.T
    if rng.random() < 0.5:  # mirrored in the plane of x and z, with the sensor
        flip = np.array([1, -1, 1.0])
        points, sensor = points * flip, sensor * flip
        joints = (joints * flip)[OTHER]
        labels = np.where(labels < 255, net.OTHER_PART[np.minimum(labels, CLASSES - 1)], 255).astype(np.uint8)
    kept = rng.random(len(points)) > rng.choice([0.0, 0.1, 0.4])
    how = rng.random()
    if how < 0.4:  # as a segmentation leaves it
        kept &= (labels < BACKGROUND) | (rng.random(len(points)) < rng.choice([0.0, 0.03, 0.15]))
    if how < 0.6:  # the floor is cut off
        kept &= points[:, 2] > rng.uniform(0.02, 0.12)
    if rng.random() < 0.1:  # out of the picture
        side = rng.integers(3)
        kept &= (
            points[:, side] * rng.choice([-1, 1]) < rng.uniform(0.1, 0.5)
            if side < 2
            else points[:, 2] > rng.uniform(0.3, 0.8)
        )
    return points[kept], labels[kept], joints, sensor


def main(folder: str, out: str, minutes: str, batch: str = "32", first: str = "") -> None:
    pool, test, many = Pool(Path(folder), "train"), Pool(Path(folder), "test"), int(batch)
    rng, clock = np.random.default_rng(0), time.process_time if jax.default_backend() == "cpu" else time.monotonic
    params = weights(Path(first)) if first else net.init(jax.random.PRNGKey(0))
    rule = optax.chain(optax.clip_by_global_norm(1.0), optax.inject_hyperparams(optax.adamw)(RATE, weight_decay=0.02))
    state: dict[str, Any] = dict(params=params, mean=params, opt=rule.init(params), seen=0, used=0.0, curve=[])
    saved, curve = Path(out).with_suffix(".state"), Path(out).with_suffix(".curve.json")
    if saved.exists():
        state = pickle.loads(saved.read_bytes())
    print(f"{sum(x.size for x in jax.tree.leaves(params))} numbers, {pool.count} crops, test {test.count}", flush=True)

    @jax.jit
    def step(params, mean, opt, b, rate):
        opt = (opt[0], opt[1]._replace(hyperparams=opt[1].hyperparams | {"learning_rate": rate}))
        (_, told), grad = jax.value_and_grad(net.loss, has_aux=True)(params, b)
        change, opt = rule.update(grad, opt, params)
        params = optax.apply_updates(params, change)
        return params, jax.tree.map(lambda a, x: KEEPS * a + (1 - KEEPS) * x, mean, params), opt, told

    measured = jax.jit(net.measured)
    highest = RATE * (AGAIN if first else 1.0)
    whole, begin = 60 * float(minutes), clock() - state["used"]
    some = range(0, min(test.count, 1536), 128)
    checks = [test.batch(np.arange(a, a + 128), None) for a in some]
    row: dict[str, float] = {}
    while state["used"] < whole:
        used = state["used"] / whole
        rate = highest * min(1.0, state["seen"] / WARM + 0.02) * max(0.01, 0.5 * (1 + np.cos(np.pi * used)))
        b = pool.batch(rng.integers(pool.count, size=many), rng)
        params, mean, opt, told = step(state["params"], state["mean"], state["opt"], b, jnp.float32(rate))
        if state["seen"] < 400 * many:
            mean = params
        state |= dict(params=params, mean=mean, opt=opt, seen=state["seen"] + many, used=clock() - begin)
        if state["seen"] // many % 16 == 0:
            row = {k: 0.95 * row.get(k, float(v)) + 0.05 * float(v) for k, v in told.items()}
        if int(used * CHECKS) != int(state["used"] / whole * CHECKS):
            pool.refresh()
            state["curve"].append(
                dict(seen=state["seen"], pool=pool.count, used=state["used"]) | row | figures(measured, mean, checks)
            )
            print(json.dumps({k: round(v, 4) for k, v in state["curve"][-1].items()}), flush=True)
            np.savez(out, **{k: np.asarray(v, np.float32) for k, v in mean.items()})  # pyright: ignore[reportArgumentType]
            saved.write_bytes(pickle.dumps(jax.device_get(state)))
            curve.write_text(json.dumps(state["curve"], indent=0))


def figures(measured, params, checks: list[dict]) -> dict[str, float]:
    """Means over the test crops."""
    found = [measured(params, b) | {"has": b["has"], "care": b["care"]} for b in checks]
    some = {k: np.concatenate([np.asarray(f[k]) for f in found]) for k in found[0]}
    has, care = some["has"] > 0, some["care"] > 0
    return dict(
        test_joint=float(some["joint"][has].mean()), test_better=float(some["better"][has].mean()),
        test_turned=float(some["turned"][has].mean()),
        test_person=float(((some["person"] > 0) == has)[care].mean()),
    )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
