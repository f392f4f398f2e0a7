"""What is at rest, and flat faces of furniture among it, against trimesh's rays and meshes."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from tests.support.beside_a_box import BOX, seen, somebody
from tests.support.rooms import FLOOR, ORIGIN
from voodoo_jax.detect.drop_planar_furniture import flat_faces, without_faces
from voodoo_jax.detect.stillness import OFTEN, resting


def off(mesh: trimesh.Trimesh, points) -> np.ndarray:
    return np.abs(trimesh.proximity.signed_distance(mesh, points))


def test_what_is_at_rest_is_known_better_than_the_noise(rng):
    frames, on_box = seen(rng)
    rest = resting(frames)
    assert len(rest.points) > 0.8 * min(box.sum() for box in on_box)
    still = trimesh.util.concatenate([BOX, somebody(0.0)])
    low = rest.points[rest.points[:, 2] < 0.7]  # box and legs
    assert np.median(off(still, low)) < 0.004 < 0.015  # of 45 measurements with 1.5 cm each
    np.testing.assert_allclose(np.linalg.norm(rest.direction, axis=1), 1, atol=1e-9)
    # each was seen in the frames that it says
    count = np.bincount(rest.which, minlength=len(rest.points))
    assert count.min() >= OFTEN * len(frames) and rest.frame.max() < len(frames)
    for k in range(0, len(frames), 11):
        mine = rest.points[rest.which[rest.frame == k]]
        nearest = np.min(np.linalg.norm(mine[:, None] - frames[k].points[None], axis=-1), 1)
        assert np.percentile(nearest, 99) < 4 * 0.015


def test_nothing_is_at_rest_for_a_sensor_that_moves_or_in_few_frames(rng):
    frames, _ = seen(rng)
    assert not len(resting(frames[:5]).points) and not len(resting([]).points)
    shift = np.cumsum(rng.normal(0, 0.05, (len(frames), 1, 3)), 0).astype(np.float32)
    moved = [replace(f, points=f.points + s, origins=f.origins + s) for f, s in zip(frames, shift)]
    assert len(resting(moved).points) < 0.05 * len(resting(frames).points)


def test_each_sensor_by_itself(rng):
    frames, _ = seen(rng)
    there = np.array([0.5, -0.3, 0.1], np.float32)
    both = [
        replace(
            f,
            points=np.concatenate([f.points, f.points + there]),
            sensor=np.repeat([0, 1], len(f.points)).astype(np.int32),
            origins=np.concatenate([ORIGIN, ORIGIN + there]),
        )
        for f in frames
    ]
    one, two = resting(frames), resting(both)
    # cells begin elsewhere: a few directions fall into others
    assert abs(len(two.points) - 2 * len(one.points)) < 0.03 * len(two.points)
    nearest = KDTree(np.concatenate([one.points, one.points + there])).query(two.points)[0]
    assert np.mean(nearest < 1e-4) > 0.97 and two.which.max() == len(two.points) - 1


@pytest.mark.parametrize("noise", [0.003, 0.015, 0.025])
def test_a_box_at_the_legs_goes_and_the_person_stays(rng, noise):
    frames, on_box = seen(rng, noise=noise)
    faces = flat_faces(resting(frames), FLOOR)
    assert len(faces) >= 2
    for face in faces:
        assert np.percentile(off(BOX, face.points), 95) < 0.01
    gone, lost = [], []
    for before, after, box in zip(frames, without_faces(frames, FLOOR), on_box):
        kept = np.isin(before.points[:, 0], after.points[:, 0])
        gone.append(np.mean(~kept[box]))
        lost.append(np.mean(~kept[~box]))
    assert np.mean(gone) > 0.6 and np.mean(lost) < 0.03  # rows on the top are too far apart


def test_nobody_has_flat_faces(rng):
    frames, _ = seen(rng, with_box=False)
    assert len(resting(frames).points) > 300
    assert without_faces(frames, FLOOR) is frames
    assert without_faces([], FLOOR) == []


def test_assigned_points_stay(rng):
    frames, on_box = seen(rng)
    named = [replace(f, part=np.where(box, 0, -1).astype(np.int32), parts=("body",)) for f, box in zip(frames, on_box)]
    for before, after, box in zip(named, without_faces(named, FLOOR), on_box):
        assert np.isin(before.points[box, 0], after.points[:, 0]).all()
