"""A face or a hand is of one person: of who is nearest to it, or stands first in the line of sight."""

import numpy as np

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Pairs, Rays
from voodoo_jax.records.scene import Scene, Subject
from voodoo_jax.trackers.icp.people import with_own_features

SCENE = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)
EYE = np.array([[0, 0, 1.2]], np.float32)
PLACES = ((2.0, 0.3), (3.0, -0.3), (4.0, 0.35))  # x and y; the third one stands behind the first


def seen(x: float, y: float, pairs: Pairs, rays: Rays, count: int = 200) -> BodyObservation:
    """A post of 1.7 m, and the features of everybody."""
    rng = np.random.default_rng(int(10 * x))
    points = np.array([x, y, 0]) + rng.uniform([-0.1, -0.2, 0.1], [0.1, 0.2, 1.7], (count, 3))
    return BodyObservation(0, points.astype(np.float32), np.zeros(count, int), EYE, rays, pairs)


def subjects(pairs: Pairs = Pairs(), rays: Rays = Rays(), shown=(1, 1, 1)) -> list[Subject]:  # noqa: B008  frozen
    frames = [seen(*place, pairs, rays, 200 * there) for place, there in zip(PLACES, shown)]
    return [Subject(k + 1, SCENE, [frame]) for k, frame in enumerate(frames)]


def towards(*targets) -> Rays:
    to = np.array(targets, np.float32) - EYE
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    return Rays(("face",) * len(to), np.repeat(EYE, len(to), 0), to, np.arange(1, len(to) + 1, dtype=np.float32))


def test_each_has_the_face_that_is_theirs_though_all_are_called_so():
    pairs = Pairs(("face",) * 3, np.array([(x, y, 1.6) for x, y in PLACES[::-1]], np.float32))
    for place, subject in zip(PLACES, with_own_features(subjects(pairs))):
        own = subject.frames[0].pairs
        assert own.names == ("face",) and own.weights is None
        np.testing.assert_allclose(own.points, [(*place, 1.6)])


def test_a_line_of_sight_is_of_who_stands_first_in_its_way():
    # over the first one's shoulder it passes nobody before the third one, at whose chest it goes through the first one
    rays = towards((2.0, 0.3, 1.5), (3.0, -0.3, 1.5), (4.0, 0.35, 1.0))
    one, two, three = with_own_features(subjects(rays=rays))
    assert [s.frames[0].rays.names for s in (one, two, three)] == [("face", "face"), ("face",), ()]
    np.testing.assert_array_equal(one.frames[0].rays.weights, [1, 3])
    np.testing.assert_array_equal(two.frames[0].rays.weights, [2])


def test_one_that_meets_nobody_is_of_whom_it_passes_most_closely():
    near = with_own_features(subjects(rays=towards((3.0, -0.75, 1.5))))
    assert [len(s.frames[0].rays.names) for s in near] == [0, 1, 0]


def test_who_is_not_seen_has_none_and_where_nobody_is_all_keep_them():
    pairs = Pairs(("hand",), np.array([(2.0, 0.3, 1.0)], np.float32))
    assert [len(s.frames[0].pairs.names) for s in with_own_features(subjects(pairs, shown=(0, 1, 0)))] == [0, 1, 0]
    before = subjects(pairs, shown=(0, 0, 0))
    for old, new in zip(before, with_own_features(before)):
        assert new.frames[0] is old.frames[0]


def test_points_and_all_else_stay_as_they_were():
    pairs = Pairs(("hand",), np.array([(2.0, 0.3, 1.0)], np.float32))
    before = subjects(pairs)
    for old, new in zip(before, with_own_features(before)):
        np.testing.assert_array_equal(new.frames[0].points, old.frames[0].points)
        assert new.number == old.number
    plain = subjects()
    assert all(new.frames[0] is old.frames[0] for old, new in zip(plain, with_own_features(plain)))
