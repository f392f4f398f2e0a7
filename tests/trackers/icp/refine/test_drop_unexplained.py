"""What is at rest and no part of the body goes, once the body is tracked."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tests.support.beside_a_stool import BODY, COUNT, frames
from tests.support.helpers import frustum_mesh, inside_body, scipy_rotation
from tests.support.segments import tracked_segment
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Status
from voodoo_jax.trackers.icp.refine.drop_unexplained import DropUnexplained
from voodoo_jax.trackers.shared.leftovers import distance_outside

STAGE = DropUnexplained(among=())


def tracked(explained: float = 0.93, status: int = Status.TRACKED) -> Segment:
    """The rest pose, tracked as it is."""
    rest = Poses(*(np.tile(np.array(x), (COUNT, 1, 1)) for x in (BODY.rest.rotation, BODY.rest.translation)))
    arrays = {"status": np.full(COUNT, status, np.int8), "explained": np.full(COUNT, explained, np.float32)}
    return tracked_segment(rest, **arrays)


def test_how_far_points_are_outside_against_meshes(rng):
    points = rng.uniform([-0.5, -0.7, 0.1], [0.5, 0.7, 1.8], (400, 3))
    found = distance_outside(BODY, points, np.zeros(400, int), tracked())
    inside = inside_body(BODY, BODY.rest, points)
    np.testing.assert_array_equal(found < 1e-6, inside)
    nearest = np.full(len(points), np.inf)
    for k, size in enumerate(np.asarray(BODY.sizes)):
        turn = scipy_rotation(BODY.rest.rotation[k])
        here = turn.inv().apply(points - np.asarray(BODY.rest.translation[k]))
        nearest = np.minimum(nearest, -trimesh.proximity.signed_distance(frustum_mesh(size, 48, 4), here))
    # along the ellipse's radius it is farther, but never much
    assert np.all(found[~inside] > nearest[~inside] - 0.005)
    assert np.all(found[~inside] < 1.1 * nearest[~inside] + 0.02)


def test_the_stool_goes_and_the_body_stays(rng):
    people = frames(rng)
    left = STAGE.without(people, [(0, BODY)], tracked())
    assert left is not None
    for before, after in zip(people, left, strict=True):
        there = {point.tobytes() for point in after.points}
        kept = np.array([point.tobytes() in there for point in before.points])
        assert kept[:1500].mean() > 0.97
        far = (
            distance_outside(BODY, before.points[1500:].astype(float), np.zeros(300, int), tracked()) > STAGE.off + 0.02
        )
        assert far.sum() > 100 and not kept[1500:][far].any()


@pytest.mark.parametrize("why", ["explained", "lost", "small"])
def test_else_nothing_is_done(rng, why):
    people = frames(rng, STAGE.fewest // 2 if why == "small" else 300)
    found = {"explained": tracked(0.997), "lost": tracked(status=Status.LOST), "small": tracked()}[why]
    assert STAGE.without(people, [(0, BODY)], found) is None


def test_each_frame_has_its_own_body(rng):
    """Half of the frames with limbs so thick that the stool is in them: explained as often as not."""
    thick = eqx.tree_at(lambda b: b.sizes, BODY, BODY.sizes + jnp.array([0.5, 0.5, 0.5, 0.5, 0.0]))
    people = frames(rng)
    assert STAGE.without(people, [(0, BODY), (COUNT // 2, thick)], tracked()) is None
    assert STAGE.without(people, [(0, thick), (COUNT // 8, BODY)], tracked()) is not None
