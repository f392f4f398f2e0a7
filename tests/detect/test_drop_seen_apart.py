"""What was seen apart from the body in other frames is no part of it."""

import numpy as np
from scipy.spatial import cKDTree

from tests.support.rooms import FLOOR, ORIGIN, box, build_of, figure, frame
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.drop_seen_apart import without_things
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene


def test_what_remains_where_somebody_was_is_not_the_body():
    """Somebody touches a thing, is out of view, and comes back a step farther on; the thing stays."""
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    thing, there, back = box(2.45, 0.43, 0.5, 0.6), figure(2.5, 0.0), figure(2.5, -1.2)
    clouds = [np.concatenate([there, thing])] * 12 + [thing] * 35 + [np.concatenate([back, thing])] * 8
    frames = [finder(frame(points, i)) for i, points in enumerate(clouds)]
    assert [len(f.points) > 0 for f in frames] == [True] * 12 + [False] * 35 + [True] * 8
    assert all(len(f.points) == (back[:, 2] > DetectSettings().floor_margin).sum() for f in frames[-8:])
    cleaned = without_things(frames, FLOOR, finder.apart())
    on_thing = lambda f: (cKDTree(thing).query(f.points)[0] < 1e-5).sum()  # noqa: E731
    assert on_thing(frames[0]) > 0.9 * len(thing) and sum(map(on_thing, cleaned)) == 0
    # what is so near that it might be the thing goes too
    assert all(len(f.points) > 0.8 * len(there) for f in cleaned[:12])


def test_what_is_left_behind_is_not_the_body():
    """Somebody touches a box at first and walks away from it: once it is alone, it is a box all the time."""
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    thing = box(2.45, 0.43, 0.5, 0.8)
    frames = [finder(frame(np.concatenate([figure(2.5, -0.12 * i), thing]), i)) for i in range(6)]
    share = [(cKDTree(f.points).query(thing.astype(np.float32))[0] < 1e-5).mean() for f in frames]
    assert share[0] > 0.9 and share[-1] == 0
    cleaned = without_things(frames, FLOOR, finder.apart())
    assert all((cKDTree(f.points).query(thing.astype(np.float32))[0] > 1e-5).all() for f in cleaned)
    assert all(len(f.points) > 0.7 * len(figure(2.5, 0.0)) for f in cleaned)


def test_what_remains_of_a_thing_goes_with_it():
    """Only the middle of a box is known: what hangs together with it goes, the foot before it and the body stay."""
    thing, body, foot = box(2.5, 0.6, 0.8, 0.5), figure(2.5, -0.1), figure(2.4, 0.1, 0.1, 0.05)
    points = np.concatenate([body, foot, thing]).astype(np.float32)
    seen = BodyObservation(0, points, np.zeros(len(points), np.int32), ORIGIN)
    known = lambda p: (np.abs(p[:, 1] - 0.45) < 0.25) & (p[:, 0] > 2.45)  # noqa: E731
    cleaned = without_things([seen], FLOOR, known)[0].points
    assert len(cleaned) == len(body) + len(foot) and cleaned[:, 1].max() < 0.2


def test_somebody_half_hidden_for_a_moment_is_left_whole():
    """Only the legs are seen for some frames: they are not taken for furniture when the rest is seen again."""
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    body = figure(2.5, 0.0)
    clouds = [body] * 12 + [body[body[:, 2] < 0.7]] * 10 + [body] * 12
    frames = [finder(frame(points, i)) for i, points in enumerate(clouds)]
    whole = len(frames[0].points)
    assert all(len(f.points) == whole for f in without_things(frames, FLOOR, finder.apart())[-12:])


def test_the_place_of_another_thing_may_be_where_the_body_was():
    """A thing stood where the body stands in other frames: frames that would lose their head are left as they are."""
    body = BodyObservation(0, figure(2.5, 0.0).astype(np.float32), np.zeros(len(figure(2.5, 0.0)), np.int32), ORIGIN)
    assert without_things([body], FLOOR, lambda points: points[:, 2] > 0.9) == [body]
    assert len(without_things([body], FLOOR, lambda points: points[:, 2] < 0.3)[0].points) < len(body.points)
