"""Whether distances are of the right scale: a rare stature makes it doubtful, a floor where it should be settles it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.segments import blank_tracks
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.markers.own_sites import with_names
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.diagnostics import notes_on
from voodoo_jax.trackers.icp.right_scale import NO_DOUBT, Scale, scale_odds, scale_of
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.tracker import with_rating

BODY, USUAL = human(), Settings()


def run_of(stature: float, settings: Settings = USUAL, floor: float = 0.0, sensor: float = 1.25) -> Runner:
    """Of a log of somebody of a stature, in which the floor is seen at a height."""
    points = np.zeros((100, 3), np.float32)
    origin = np.array([[0.0, 0.0, sensor]], np.float32)
    frame = BodyObservation(0, points, np.zeros(100, int), origin)
    options = options_from(settings.solve, settings.track, settings.features)
    scene = Scene(Plane(np.array([0.0, 0.0, 1.0], np.float32), floor), (), True)
    run = Runner(BODY, options, [frame], scene, settings)
    run.body = scaled(BODY, stature)
    return run


def thought(run: Runner) -> Scale:
    return scale_of(run.body, run.scene, run.people, run.settings)


@pytest.mark.parametrize("stature", [1.0, 1.15, 1.3, 1.5, 1.7, 1.9, 1.95])
def test_who_is_small_or_tall_is_no_doubt(stature):
    assert scale_odds(stature) == NO_DOUBT


@pytest.mark.parametrize("factor", [0.75, 1.2, 1.3])
def test_a_rare_stature_with_a_floor_elsewhere_is_of_a_wrong_scale(factor):
    """Somebody of 1.64 m whose distances are too large or small: the factor is found, with the floor much surer."""
    alone, both = scale_odds(1.64 * factor), scale_odds(1.64 * factor, 1.25, 1.25 * (1 - factor))
    assert both.right < 0.6 and both.right < alone.right
    assert both.factor == pytest.approx(factor, rel=0.04)


def test_a_floor_where_it_should_be_settles_the_scale():
    assert scale_odds(2.04).right < 0.6
    assert scale_odds(2.04, 1.25, 0.0) == NO_DOUBT


def test_a_frame_that_is_not_on_the_floor_is_no_doubt():
    """A robot's body frame is 20 cm above the floor, and somebody usual before it."""
    assert scale_odds(1.75, 1.0, -0.2) == NO_DOUBT


def test_a_doubtful_scale_makes_all_joints_less_sure_and_is_said():
    """But nobody is lost for it, and a stature or a scale that is given settles it."""
    run, limbs, joints = run_of(2.05, floor=-0.375), BODY.limb_count, len(BODY.topology.centres)
    named = with_names(BODY, run.people, run.settings)[2]
    tracks = blank_tracks(
        run.body, 1,
        joints=np.zeros((1, joints, 3), np.float32), status=np.full(1, Status.TRACKED, np.int8),
        limb_covariance=np.broadcast_to(1e-4 * np.eye(6, dtype=np.float32), (1, limbs, 6, 6)),
        residual=np.full(1, 0.01, np.float32), explained=np.ones(1, np.float32),
        limb_weight=np.full((1, limbs), 40.0, np.float32), passes_apart=np.zeros((1, limbs), np.float32),
    )  # fmt: skip
    doubted, sure = with_rating(run, tracks), with_rating(run_of(1.75), tracks)
    assert thought(run).right < 0.2
    assert doubted.joint_confidence is not None and sure.joint_confidence is not None
    np.testing.assert_allclose(doubted.joint_confidence, thought(run).right * sure.joint_confidence, rtol=1e-5)
    assert sure.tracked.all() and doubted.tracked.all()
    said = [note for note in notes_on(run, doubted, named) if "read.scale" in note]
    assert len(said) == 1 and "2.05 m" in said[0] and "38 cm below" in said[0] and " 1.29 times" in said[0]
    assert not any("read.scale" in note for note in notes_on(run_of(1.75), sure, named))


def test_what_a_user_says_settles_the_scale():
    tall = replace(USUAL, start=replace(USUAL.start, scale=2.05))
    unit = replace(USUAL, read=replace(USUAL.read, scale=("/depth=0.001",)))
    assert [thought(run_of(2.05, each, -0.375)) for each in (tall, unit)] == [NO_DOUBT, NO_DOUBT]


def test_a_frame_that_tells_no_height_leaves_the_stature():
    """The fixed frame is the camera's: how far below it the floor is depends on how it stands."""
    assert thought(run_of(2.05, floor=-1.2, sensor=0.0)).right == pytest.approx(scale_odds(2.05).right, rel=1e-3)
