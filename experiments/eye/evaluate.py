"""The eye judged: python -m experiments.eye.evaluate WEIGHTS.npz test DATA | rooms COUNT | logs EVERY LOG ...

`test`: crops of people left out, by posture. `rooms`: false alarms in rooms with furniture and nobody. `logs`: from
scratch, every EVERY-th frame of logs with a truth beside them: found, joints, turned; false alarms where nobody is.
"""

import sys
import time
from pathlib import Path

import numpy as np

import voodoo_jax as vj
from experiments.common import table
from experiments.eye import net
from experiments.eye.look import people
from experiments.eye.midway import turned
from experiments.eye.train import Pool
from experiments.rooms.furnished import FURNITURE
from experiments.scoreboard.tracked import read_known
from voodoo_jax.kernels.eye import JOINTS
from voodoo_jax.simulate.room import Box, Room, render_room
from voodoo_jax.simulate.sensor import TOF_NOISE, add_noise, tof_camera
from voodoo_jax.trackers.shared.eye import weights as weights_in

FAR = 0.5  # metres: who is farther off is somebody else
SURE = (0.0, 2.0, 4.0)  # logarithms of the odds that somebody is there
SURER = (0.5, 1.0, 2.0, 3.0, 4.0)  # logarithms of odds


def on_crops(weights: Path, folder: Path) -> str:
    """By posture: joints, turned, somebody or not; and whether the odds are right."""
    pool, params = Pool(folder, "test"), weights_in(weights)
    some = [pool.batch(np.arange(a, min(a + 128, pool.count)), None) for a in range(0, pool.count, 128)]
    told = [{k: np.asarray(v) for k, v in net.measured(params, b).items()} | {"has": b["has"]} for b in some]
    found = {k: np.concatenate([t[k] for t in told]) for k in told[0]}
    kind, has = pool.arrays["kind"][: pool.count], found["has"] > 0
    rows = []
    for name in ("all", *sorted(set(kind.tolist()) - {"nobody"})):
        m = has & ((kind == name) | (name == "all"))
        cm = [f"{100 * found[k][m].mean():.1f}" for k in ("joint", "better", "own")]
        rows.append([name, str(m.sum()), *cm, *(f"{100 * x:.0f}" for x in
                    (found["turned"][m].mean(), (found["person"][m] > 0).mean()))])  # fmt: skip
    nobody = ~pool.arrays["person"][: pool.count].astype(bool)
    text = table(["posture", "crops", "joints, cm", "better way", "says", "turned, %", "somebody, %"], rows)
    text += (
        f"\nnobody: {nobody.sum()} crops, {100 * (found['person'][nobody] > 0).mean():.1f} % taken for somebody.\n\n"
    )
    edges = [0, *SURER, np.inf]
    for low, high in zip(edges, edges[1:]):
        m = has & (found["odds"] >= low) & (found["odds"] < high)
        text += f"odds {low:.1f} to {high:.1f}: {m.sum()} crops, {100 * found['turned'][m].mean():.1f} % turned\n"
    return text


def on_rooms(weights: Path, count: int) -> str:
    """In how many rooms somebody is seen; a frame of each, looked at from scratch."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng([seed, 61])
        camera = tof_camera(float(rng.uniform(0.7, 1.9)), float(rng.uniform(0.0, 0.2)))
        boxes = tuple(
            Box(float(rng.uniform(1.2, 4.5)), float(rng.uniform(-1.8, 1.8)), size, float(rng.uniform(0, np.pi)))
            for size in rng.permutation(FURNITURE)[: rng.integers(2, 8)]
        )
        depth = add_noise(*render_room(camera, Room(boxes=boxes)), camera, TOF_NOISE, rng) / 1000
        origin = np.array(camera.position)
        points = (camera.rays() * depth.reshape(-1, 1) + origin)[depth.ravel() > 0]
        found.append([s.person for s in people(weights, points, origin, most=9)])
    above = [[sum(odds > low for odds in some) for some in found] for low in SURE]
    rows = [
        [f"{low:.0f}", f"{100 * np.mean(np.array(n) > 0):.0f}", f"{100 * np.mean(n):.0f}"]
        for low, n in zip(SURE, above)
    ]
    return table(["logarithm of the odds above", "rooms with somebody, %", "seen in 100 rooms"], rows)


def on_logs(weights: Path, every: int, logs: list[Path]) -> str:
    rows, every_one = [], []
    for path in logs:
        known, recording = read_known(path.with_suffix(".truth.npz")), vj.read_log(path)
        truths = known.joints[None] if known.joints.ndim == 3 else known.joints
        with np.load(path.with_suffix(".truth.npz")) as file:
            pixels = file["pixels"] if "pixels" in file else np.full(truths.shape[:2], 1000)
        mine = [k for k, name in enumerate(JOINTS) if name in known.names]
        names = tuple(JOINTS[k] for k in mine)
        theirs, got, spent, false = [known.names.index(n) for n in names], [], [], 0
        for frame in recording.frames[::every]:
            at = int(np.abs(known.stamps - frame.time_ns).argmin())
            begin = time.process_time()
            found = people(weights, frame.points, frame.origins[0].astype(float), len(truths))
            spent.append(time.process_time() - begin)
            claimed = set()
            for truth, seen in zip(truths[:, at][:, theirs], pixels[:, at]):
                if seen < 250 or not np.isfinite(truth).all():
                    continue
                away = [np.linalg.norm(f.joints[mine] - truth, axis=-1).mean() for f in found]
                best = int(np.argmin(away)) if away else -1
                if best < 0 or away[best] > FAR:
                    got.append((0, np.nan, np.nan, np.nan))
                    continue
                claimed.add(best)
                got.append((1, away[best], turned(found[best].joints[mine], truth, names), found[best].odds))
            false += len(found) - len(claimed)
        every_one += got
        rows.append(
            [path.stem, *_cells(np.array(got, float), false / max(1, len(spent))), f"{1e3 * np.median(spent):.0f}"]
        )
    rows.append(["all", *_cells(np.array(every_one, float), np.nan), ""])
    head = ["log", "people", "found, %", "joints, cm", "turned, %", "turned of odds > 2, %", "false/frame", "ms/frame"]
    return table(head, rows)


def _cells(got: np.ndarray, false: float) -> list[str]:
    if not len(got):
        return ["0", "", "", "", "", f"{false:.2f}"]
    sure = got[:, 3] > 2
    means = [
        100 * np.nanmean(x) if np.isfinite(x).any() else np.nan for x in (got[:, 0], got[:, 1], got[:, 2], got[sure, 2])
    ]
    return [str(len(got)), f"{means[0]:.0f}", f"{means[1]:.1f}", f"{means[2]:.0f}", f"{means[3]:.0f}", f"{false:.2f}"]


if __name__ == "__main__":
    if sys.argv[2] == "test":
        print(on_crops(Path(sys.argv[1]), Path(sys.argv[3])))
    elif sys.argv[2] == "rooms":
        print(on_rooms(Path(sys.argv[1]), int(sys.argv[3])))
    else:
        print(on_logs(Path(sys.argv[1]), int(sys.argv[3]), [Path(a) for a in sys.argv[4:]]))
