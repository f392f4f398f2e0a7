"""The eye as one more start hypothesis of the tracker, judged by the tracker's own cost, and as what tells its facing:
for a trial without touching the package."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from experiments.eye import net
from experiments.eye.data import JOINTS
from experiments.eye.look import Seen, centred, thinned
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.markers.first_pose import first_pose
from voodoo_jax.model.body import Body
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start import hypothesis
from voodoo_jax.trackers.icp.start.first_facing import FirstFacing
from voodoo_jax.trackers.icp.start.stage import Search
from voodoo_jax.trackers.icp.trials import facing

NAMES = {"l_wrist": "l_radiocarpal", "r_wrist": "r_radiocarpal", "l_ankle": "l_talocrural", "r_ankle": "r_talocrural"}
EVERY, CLEARLY = 3, 0.5  # frames of which the eye sees one; logarithm of the odds against a start that turn it round
SURE = 0.3  # metres of own error: joints with more are not asked


def poses_of(body: Body, joints: np.ndarray, known: np.ndarray) -> Poses:
    """The body with its joints where the eye has them."""
    sites, centres = len(body.topology.site_limbs), body.topology.centres
    rows = np.array([sites + centres.index(NAMES.get(name, name)) for name in JOINTS])
    turn, at, _ = first_pose(body, rows, joints, known, scaled_by=1.0)
    return Poses(turn.astype(np.float32), at.astype(np.float32))


def seen_by(weights: Path, run: Runner, at: int) -> Seen | None:
    """What the eye says of the points on the body in a frame; in the scene's frame with z up."""
    frame, floor = run.people[at], run.scene.floor
    if not len(frame.points) or floor.normal[2] < 0.99:
        return None
    low = floor.height(np.zeros((1, 3)))[0]
    points = thinned(frame.points + [0, 0, low], 0.02)
    sensor = frame.origins[int(np.bincount(frame.sensor).argmax())] + [0, 0, low]
    seen = centred(weights, points, sensor, np.median(points[:, :2], 0))
    return seen._replace(joints=seen.joints - [0, 0, low])


def odds_of(weights: Path, run: Runner, start: hypothesis.StartHypothesis) -> float:
    """Logarithm of the odds that a start faces the right way: mean over the frames that a size is found from."""
    way = facing(on_host(run.body), start.poses.rotation[None])[0, :2]
    every = range(start.frame, min(start.frame + run.settings.start.size_frames, len(run.people)), EVERY)
    each = [seen for at in every if (seen := seen_by(weights, run, at)) is not None]
    told = [seen.odds * float(np.sign(np.asarray(net.ahead(seen.joints)) @ way)) for seen in each]
    return float(np.mean(told)) if told else 0.0


@contextmanager
def with_eye(weights: Path, facing_too: bool = False) -> Iterator[None]:
    """Starts are tried from the eye's pose, too, beside all others; with `facing_too` it is the eye that takes a
    start's rival, and not first_facing."""
    today, first_facing = hypothesis.best_from, FirstFacing.__call__

    def best_from(run: Runner, at: int, body: Body, places: list[Poses]) -> hypothesis.StartHypothesis:
        seen = seen_by(weights, run, at)
        if seen is not None:
            places = [*places, poses_of(body, seen.joints, seen.spread < SURE)]
        return today(run, at, body, places)

    def by_eye(_: FirstFacing, run: Runner, search: Search) -> Search:
        start = search.best
        if run.settings.looks_ahead("track") or start.rival is None or odds_of(weights, run, start) > -CLEARLY:
            return search
        return search._replace(best=start.rival._replace(rival=start._replace(rival=None)))

    hypothesis.best_from = best_from
    if facing_too:
        setattr(FirstFacing, "__call__", by_eye)  # noqa: B010  it has a type of its own
    try:
        yield
    finally:
        hypothesis.best_from = today
        setattr(FirstFacing, "__call__", first_facing)  # noqa: B010
