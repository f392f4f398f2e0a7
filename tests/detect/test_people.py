"""Everybody in view is followed, each with their own points, from when they come until they leave."""

import numpy as np
import pytest

from tests.support.rooms import FLOOR, box, build_of, figure, frame
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.detect.tracklets import LOOK, Observed, Tracklets
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.scene import Scene
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera

CAMERA = tof_camera(1.2, 0.0)
SCENE, SETTINGS = Scene(FLOOR, (), True), DetectSettings(points=100_000)


def everybody(clouds, ahead=True) -> tuple[list[list[np.ndarray]], list[np.ndarray]]:
    """Points of each person in each frame, and those of the main one."""
    tracklets = Tracklets(SCENE, build_of(1.75), SETTINGS, ahead, several=True)
    main = list(tracklets(frame(cloud, i) for i, cloud in enumerate(clouds)))
    return [_points(one) for one in tracklets.people(main)], [f.points for f in main]


def _points(one: Observed) -> list[np.ndarray]:
    return [f.points for f in one.frames]


def sways(i: int) -> float:
    return 0.2 * np.sin(i / 4)


def side(points: np.ndarray, left: bool) -> bool:
    return len(points) > 100 and bool(np.all((points[:, 1] > 0) == left))


@pytest.mark.parametrize("apart", [1.2, 0.85])  # so that they touch at times: their cylinders are 0.36 m wide
def test_two_people_have_their_own_points(apart):
    clouds = [
        np.concatenate([figure(3.0, apart / 2 + sways(i), 1.8), figure(3.1, -apart / 2 + sways(i + 9), 1.6)])
        for i in range(60)
    ]
    found, _ = everybody(clouds)
    assert len(found) == 2
    for points in found:
        own = [np.mean(p[:, 1]) for p in points]
        assert len(own) == 60 and (np.min(own) > 0) != (np.max(own) < 0)
        assert min(map(len, points)) > 0.75 * max(map(len, points))


def test_nobody_is_looked_for_twice_once_two_are_people(monkeypatch):
    """Whom the chooser follows is one of them; that goes on when both have left and one comes back."""
    looks, look = [], BodySegmenter.__call__

    def counted(self, seen, *args, **more):
        looks.append(seen.time_ns)
        return look(self, seen, *args, **more)

    monkeypatch.setattr(BodySegmenter, "__call__", counted)
    wall = np.stack([np.full(400, 9.0), *np.random.default_rng(0).uniform(-1, 1, (2, 400))], 1).astype(np.float32)
    one, other = ([figure(3.0, side + sways(i), 1.8) for i in range(140)] for side in (0.8, -0.8))
    clouds = [
        np.concatenate([wall, *([one[i]] if i < 60 or i >= 110 else []), *([other[i]] if i < 90 else [])])
        for i in range(140)
    ]
    found, main = everybody(clouds)
    count = np.unique(looks, return_counts=True)[1]
    usual = np.delete(np.arange(40, 60), np.arange(0, 20, LOOK))  # not those in which somebody else is looked for
    np.testing.assert_array_equal(count[usual], 2)
    assert len(found) == 2 and len(main) == 140
    ends = sorted(max(k for k, p in enumerate(points) if len(p) > 100) for points in found)
    assert ends == [59, 139] and len(main[-1]) > 100  # who comes last is taken for who left last, of the same height


def test_what_never_moves_is_nobody_and_changes_nothing():
    coats = figure(3.2, -0.8, 1.75)
    walks = [np.concatenate([coats, figure(3.0, 0.6 + 0.03 * i, 1.6)]) for i in range(40)]
    found, main = everybody(walks)
    assert not found
    alone = [f.points for f in Tracklets(SCENE, build_of(1.75), SETTINGS)(frame(c, i) for i, c in enumerate(walks))]
    for points, as_before in zip(main, alone, strict=True):
        np.testing.assert_array_equal(points, as_before)


@pytest.mark.parametrize("lives", [True, False])
def test_who_stands_still_sways_and_a_thing_does_not(lives):
    rng = np.random.default_rng(4)

    def cloud(i):
        sway = 0.006 * np.array([np.sin(i / 9), np.sin(i / 13 + 1)]) * lives
        still = figure(3.2 + sway[0], -0.8 + sway[1], 1.7)
        return np.concatenate([figure(3.0, 0.8 + sways(i), 1.8), still + rng.normal(0, 0.004, still.shape)])

    found, _ = everybody([cloud(i) for i in range(80)])
    assert len(found) == (2 if lives else 0)


def test_a_cupboard_before_which_somebody_moves_is_nobody():
    rng = np.random.default_rng(5)
    still = box(4.2, -0.5, 0.7, 1.7)

    def cloud(i):
        person = figure(3.0, 0.1 + sways(i), 1.8)
        edge = np.max(person[:, 1]), np.min(person[:, 1])
        seen = still[(still[:, 1] * 3 / 4.2 > edge[0]) | (still[:, 1] * 3 / 4.2 < edge[1])]
        return np.concatenate([person, seen + rng.normal(0, 0.004, seen.shape)])

    assert not everybody([cloud(i) for i in range(80)])[0]


@pytest.mark.parametrize("wide, at", [(0.8, -0.1), (0.6, 0.0)])
def test_a_cupboard_that_somebody_passes_once_is_nobody(wide, at):
    """For fewer frames than make an edge of it: other points of it are seen in a direction for a moment."""
    rng = np.random.default_rng(6)
    cupboard = box(4.6, -0.6, wide, 1.75)
    walks = [figure(4.0, 1.5 - 0.04 * max(0, i - 80), 1.6) for i in range(140)]

    def seen(points, *hidden_by):
        y = points[:, 1] / points[:, 0]
        for other in hidden_by:
            aside = other[:, 1] / other[:, 0]
            points, y = (v[(y > aside.max()) | (y < aside.min())] for v in (points, y))
        return points + rng.normal(0, 0.004, points.shape)

    def cloud(i):
        near = figure(2.5, at + 0.1 * sways(i), 1.9)
        return np.concatenate([near, seen(walks[i], near), seen(cupboard, near, walks[i])])

    assert len(everybody([cloud(i) for i in range(140)])[0]) == 2


@pytest.mark.parametrize("ahead", [True, False])
def test_who_comes_in_and_leaves_is_there_meanwhile(ahead):
    def cloud(i):
        here = [figure(3.0, 1.0 + sways(i), 1.8)]
        return np.concatenate([*here, figure(3.6, -2.5 + 0.06 * i, 1.6)]) if 25 <= i < 60 else here[0]

    found, _ = everybody([cloud(i) for i in range(80)], ahead)
    assert len(found) == 2
    seen = np.flatnonzero([len(p) > 100 for p in found[1]])
    assert seen[0] == 25 if ahead else seen[0] <= 31
    assert seen[-1] == 59 and len(seen) == seen[-1] - seen[0] + 1
    assert all(side(p, True) for p in found[0])


def behind(i: int, height: float) -> np.ndarray:
    """Somebody who walks behind a broad cupboard, and comes out on its other side."""
    y = 1.6 - 0.04 * i
    hidden = abs(y) < 0.8
    return np.zeros((0, 3)) if hidden else figure(4.0, y, height)


@pytest.mark.parametrize("height, people", [(1.8, 2), (1.55, 3)])
def test_who_was_hidden_for_long_is_the_same_if_the_size_is(height, people):
    clouds = [
        np.concatenate([figure(2.5, 2.2 + sways(i), 1.7), behind(i, 1.8 if i < 40 else height)]) for i in range(80)
    ]
    found, _ = everybody(clouds)
    assert len(found) == people


def test_four_who_stand_shoulder_to_shoulder_from_the_first_frame_on_are_four():
    rng, people = np.random.default_rng(6), []
    for stature, y in ((1.8, 0.9), (1.65, -0.85), (1.7, 0.32), (1.9, -0.28)):
        body = scaled(human(), stature)
        seen = simulate(body, placed(make_motion(body, "stand", 0.1, 10.0), 4.0, y, np.pi), CAMERA, room=None)
        depth = seen.depth[0].ravel() / 1000.0
        points = CAMERA.rays()[depth > 0] * depth[depth > 0, None] + np.array(CAMERA.position)
        people.append((points[points[:, 2] > 0.05], rng.uniform(0, 6, 2)))

    def cloud(i):
        sway = [[*0.012 * np.sin(i * np.array([0.11, 0.07]) + phase), 0.0] for _, phase in people]
        here = np.concatenate([points + shift for (points, _), shift in zip(people, sway)])
        return here + rng.normal(0, 0.003, here.shape)

    found, _ = everybody([cloud(i) for i in range(70)])
    middle = sorted(float(np.median(np.concatenate(points)[:, 1])) for points in found)
    np.testing.assert_allclose(middle, [-0.85, -0.28, 0.32, 0.9], atol=0.05)
