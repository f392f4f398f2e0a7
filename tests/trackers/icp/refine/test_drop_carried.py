"""What is carried goes, the body stays; and only where that explains far more."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.helpers import seen_points
from voodoo_jax.config.options import Settings, SolveSettings, TrackSettings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.refine.drop_carried import CARRIED_NOTE, DropCarried, unexplained
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.sequence import Whole
from voodoo_jax.trackers.shared.segment import Followed

BODY, COUNT = scaled(human(), 1.7), 20
STAGE, FLOOR = DropCarried(among=()), Plane(np.array([0, 0, 1], np.float32), 0.0)
SCENE = Scene(FLOOR, (), False)
AHEAD, ASIDE, BEHIND = (np.array([at], np.float32) for at in ((3.0, 0, 1.2), (0, 3.0, 1.2), (-3.0, 0, 1.2)))
# lower and upper corner, metres: on the back of who looks along x; before the chest
PACK, CARTON = ((-0.38, -0.16, 0.95), (-0.13, 0.16, 1.42)), ((0.2, -0.2, 0.85), (0.5, 0.2, 1.2))


def frames(rng, sensor, thing=None, until: int = COUNT) -> list[BodyObservation]:
    """The body in the rest pose, and in the first frames 600 points in a thing between two corners, the last ones."""
    body = seen_points(rng, BODY, BODY.rest, sensor[0], 1000)
    out = []
    for k in range(COUNT):
        some = rng.uniform(*thing, (600, 3)) if thing is not None and k < until else np.zeros((0, 3))
        points = np.concatenate([body, some]) + rng.normal(0, 0.008, (len(body) + len(some), 3))
        seen = points.astype(np.float32)
        out.append(BodyObservation(k * 66_000_000, seen, np.zeros(len(seen), np.int32), sensor, noise=0.008))
    return out


@pytest.mark.parametrize(("sensor", "thing"), [(ASIDE, PACK), (BEHIND, PACK), (AHEAD, CARTON)])
def test_the_thing_goes_and_the_body_stays(rng, sensor, thing):
    people = frames(rng, sensor, thing)
    left = STAGE.without(people, FLOOR)
    assert left is not None
    for before, after in zip(people, left, strict=True):
        there = {point.tobytes() for point in after.points}
        kept = np.array([point.tobytes() in there for point in before.points])
        assert kept[1000:].mean() < 0.4 and kept[:1000].mean() > 0.95


@pytest.mark.parametrize("sensor", [AHEAD, ASIDE])
def test_who_carries_nothing_or_for_a_moment_keeps_all(rng, sensor):
    assert STAGE.without(frames(rng, sensor), FLOOR) is None
    assert STAGE.without(frames(rng, sensor, PACK, COUNT // 3), FLOOR) is None
    assert STAGE.without([], FLOOR) is None


def whole_of(people: list[BodyObservation], cost: float | np.ndarray) -> Whole:
    """A recording that is tracked at such a cost in each frame."""
    arrays = {"cost": np.broadcast_to(cost, COUNT).copy(), "residual": np.ones(COUNT, np.float32)}
    segment = replace(Followed.blank(COUNT, BODY.limb_count), explained=np.ones(COUNT, np.float32), **arrays)
    run = Runner(BODY, options_from(SolveSettings(), TrackSettings()), people, SCENE, Settings())
    return Whole(run, segment, 0, 0, np.ones(COUNT, bool))


@pytest.mark.parametrize(
    ("cost", "then", "taken"),
    [(2e-3, 4e-4, True), (2e-3, 1.5e-3, False), (5e-4, 4e-4, False)],
    ids=["helps", "does not help", "fits"],
)
def test_it_is_taken_where_far_less_is_unexplained_then(rng, monkeypatch, cost, then, taken):
    people = frames(rng, ASIDE, PACK)
    before = whole_of(people, cost)
    assert unexplained(before) == pytest.approx(cost - 0.018**2)
    asked = []

    def anew(whole: Whole, stages, left) -> Whole:
        asked.append(sum(len(f.points) for f in left))
        return replace(whole_of(people, then), notes=whole.notes)

    monkeypatch.setattr(Whole, "tracked_anew", anew)
    after = STAGE(replace(before, notes=("first",)))
    assert after.notes == (("first", CARRIED_NOTE) if taken else ("first",))
    assert unexplained(after) == pytest.approx((then if taken else cost) - 0.018**2)
    assert len(asked) == (cost == 2e-3) and all(count < COUNT * 1400 for count in asked)


def test_some_frames_that_are_tracked_wrongly_are_not_a_carried_object(rng, monkeypatch):
    """As where a person passes behind another: the mean is high, but most frames are explained."""
    cost = np.where(np.arange(COUNT) < COUNT // 3, 1e-2, 3e-4)
    whole = whole_of(frames(rng, ASIDE, PACK), cost)
    monkeypatch.setattr(Whole, "tracked_anew", lambda *_: pytest.fail("tracked again"))
    assert STAGE(whole) is whole
