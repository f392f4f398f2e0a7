"""Whether the fixed frame stands level: a floor that slopes makes its transforms doubtful, and a user settles it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.segments import blank_tracks
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.markers.own_sites import with_names
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.diagnostics import NO_DOUBT, level_odds, level_of, log_doubts, notes_on
from voodoo_jax.trackers.icp.runner import Runner

USUAL, MOUNT = Settings(), np.array([[0.0, 0.0, 1.25]], np.float32)


def seen(origins: np.ndarray = MOUNT, **more) -> BodyObservation:
    return BodyObservation(0, np.zeros((100, 3), np.float32), np.zeros(100, int), origins, **more)


def sloping(degrees: float, floor_seen: bool = True) -> Scene:
    turn = np.radians(degrees)
    return Scene(Plane(np.array([np.sin(turn), 0, np.cos(turn)], np.float32), 0.0), (), floor_seen)


def test_the_more_it_slopes_the_less_it_is_believed():
    assert [level_odds(degrees) for degrees in (0, 0.6, 1.1, 2, 3)] == [NO_DOUBT] * 5
    right = [level_odds(degrees).right for degrees in (4, 5, 8, 12)]
    assert right == sorted(right, reverse=True) and right[0] < 0.8 and right[-1] < 0.1


@pytest.mark.parametrize(
    "scene, people, settings",
    [
        (sloping(12, floor_seen=False), [seen()], USUAL),
        (sloping(12), [seen(np.zeros((1, 3), np.float32))], USUAL),
        (sloping(12), [seen(), seen(T_fixed_steady=np.eye(4))], USUAL),
        (sloping(12), [seen()], replace(USUAL, read=replace(USUAL.read, up="0.2,0,1"))),
        (sloping(95), [seen()], USUAL),
        (sloping(12), [], USUAL),
    ],
    ids=["no floor", "the sensor's own frame", "sensors that move", "told", "another axis is up", "nothing"],
)
def test_no_doubt_where_nothing_says_how_it_stands(scene, people, settings):
    assert level_of(sloping(12), [seen()], USUAL).right < 0.1
    assert level_of(scene, people, settings) == NO_DOUBT


def test_it_is_said_with_what_settles_it_and_lowers_the_confidence():
    settings, body = USUAL, human()
    options = options_from(settings.solve, settings.track, settings.features)
    run = Runner(body, options, [seen()], sloping(12), settings)
    named = with_names(body, run.people, run.settings)[2]
    tracks = blank_tracks(
        body, 1, status=np.full(1, Status.TRACKED, np.int8),
        beyond_limits=np.zeros((1, len(body.topology.joints)), np.float32),
        depth_inside=np.zeros((1, body.limb_count), np.float32),
    )  # fmt: skip
    said = [note for note in notes_on(run, tracks, named) if "read.transform" in note]
    assert len(said) == 1 and "12 degrees" in said[0] and "read.up=0.21,0.00,0.98" in said[0]
    assert log_doubts(body, run.scene, run.people, settings).right < 0.1
