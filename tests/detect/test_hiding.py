"""What hides what, against rays and meshes of trimesh."""

import numpy as np
import trimesh

from tests.support.still_things import block, watched
from voodoo_jax.detect.visibility import BIN, NEARER, Nearest, has_far_sides


def test_what_is_hidden_is_what_rays_meet_something_before(rng):
    origins = np.array([[0, 0, 1.2], [2.0, -1.5, 0.8]], np.float32)
    ball = trimesh.creation.icosphere(4, 0.4)
    ball.apply_translation([2.0, 0.3, 1.1])
    surface = ball.triangles_center[:, None]  # thousands of points: several in each direction
    facing = np.einsum("fi,fsi->fs", ball.face_normals, origins - surface) > 0
    face, sensor = np.nonzero(facing)
    near = Nearest.of(surface[face, 0].astype(np.float32), sensor.astype(np.int32), origins)
    places = rng.uniform([0.5, -2, 0], [4, 2, 2.5], (4000, 3)).astype(np.float32)
    of = rng.integers(0, 2, len(places)).astype(np.int32)
    hidden = near.hides(places, of)
    away = places - origins[of]
    reach = np.linalg.norm(away, axis=1)
    distance = np.full(len(places), np.inf)
    where, ray, _ = ball.ray.intersects_location(origins[of], away / reach[:, None], multiple_hits=True)
    np.minimum.at(distance, ray, np.linalg.norm(where - origins[of][ray], axis=1))
    # bins are coarse: not where the ball's edge is in the same bin, nor where it is just before or behind the place
    towards = ball.center_mass - origins[of]
    angle = np.arccos(np.sum(away * towards, 1) / reach / np.linalg.norm(towards, axis=1))
    edge = np.arcsin(0.4 / np.linalg.norm(towards, axis=1))
    clear = (np.abs(angle - edge) > np.radians(1.5 * BIN)) & (np.abs(reach - distance - NEARER) > 0.15)
    assert 100 < hidden[clear].sum() < clear.sum() - 100
    np.testing.assert_array_equal(hidden[clear], (distance < reach - NEARER)[clear])
    # where nothing is seen nobody knows whether it is empty
    clear &= np.abs(distance - reach - NEARER) > 0.15
    through = near.empty(places, of)
    np.testing.assert_array_equal(through[clear], (np.isfinite(distance) & (distance > reach + NEARER))[clear])
    halfway = (surface[face, 0] + origins[sensor]) / 2
    assert near.empty(halfway.astype(np.float32), sensor.astype(np.int32)).all()


def test_nothing_is_hidden_by_nothing():
    origins, none = np.zeros((1, 3), np.float32), np.zeros((0, 3), np.float32)
    points = np.array([[1, 0, 0], [0, 0, -1], [0, 0, 1], [-1, 0, 0], [-1, -1e-9, 0]], np.float32)
    sensor = np.zeros(5, np.int32)
    assert not Nearest.of(none, sensor[:0], origins).hides(points, sensor).any()
    assert not Nearest.of(points, sensor, origins).hides(points, sensor).any()
    assert Nearest.of(points, sensor, origins).hides(2 * points, sensor).all()
    assert not Nearest.of(none, sensor[:0], origins).empty(points, sensor).any()
    assert Nearest.of(2 * points, sensor, origins).empty(points, sensor).all()


def test_joined_clouds_have_points_behind_points(rng):
    front, hand = block(0.45, 0.1, 1.75), block(0.1, 0.9, 1.1, far=2.7)
    still = np.zeros((5, 3))
    assert not has_far_sides(watched(rng, [(front, still), (hand, still)], 5))  # a limb hides another one
    back = block(0.43, 0.1, 1.75, far=3.25)
    assert has_far_sides(watched(rng, [(front, still), (back, still)], 5))
    assert not has_far_sides([])
