"""What stayed in its place while the body came or went is furniture."""

import numpy as np
from scipy.spatial import cKDTree

from tests.support.rooms import FLOOR, ORIGIN, box, figure
from voodoo_jax.detect.drop_touched_furniture import without_furniture
from voodoo_jax.records.observation import PersonFrame


def walking(count: int, chair, start: float, speed: float) -> list[PersonFrame]:
    frames = []
    for i in range(count):
        points = np.concatenate([figure(2.5, start + speed * i), chair]).astype(np.float32)
        frames.append(PersonFrame(i, points, np.zeros(len(points), np.int32), ORIGIN))
    return frames


def test_furniture_goes_when_the_person_walks_away():
    chair = box(2.5, -0.35, 0.3, 0.6).astype(np.float32)
    frames = walking(40, chair, 0.0, 0.04)
    cleaned = without_furniture(frames, FLOOR.normal)
    on_chair = lambda f: (cKDTree(chair).query(f.points)[0] < 1e-5).sum()  # noqa: E731
    assert sum(map(on_chair, frames)) == 40 * len(chair) and sum(map(on_chair, cleaned)) == 0
    for i in (20, 39):  # away from the chair the person is whole
        assert len(cleaned[i].points) > 0.98 * len(frames[i].points) - len(chair)
    assert [f.time_ns for f in cleaned] == list(range(40)) and all(len(f.sensor) == len(f.points) for f in cleaned)


def test_a_person_who_stays_or_walks_alone_is_left_whole():
    none = np.zeros((0, 3), np.float32)
    for frames in (
        walking(30, box(2.5, -0.35, 0.3, 0.6), 0.0, 0.0),
        walking(40, none, 0.0, 0.04),
        walking(5, none, 0, 1),
    ):
        for before, after in zip(frames, without_furniture(frames, FLOOR.normal)):
            np.testing.assert_array_equal(before.points, after.points)


def test_furniture_keeps_assigned_points():
    chair = box(2.5, -0.35, 0.3, 0.6).astype(np.float32)
    frames = []
    for f in walking(40, chair, 0.0, 0.04):
        part = np.where(np.arange(len(f.points)) >= len(f.points) - 5, 0, -1).astype(np.int32)
        frames.append(PersonFrame(f.time_ns, f.points, f.sensor, f.origins, part=part, parts=("body",)))
    for got in without_furniture(frames, FLOOR.normal):
        assert got.part is not None and (got.part == 0).sum() == 5
        assert (cKDTree(chair).query(got.points[got.part == -1])[0] < 1e-5).sum() == 0
