"""Points of people who are close to each other go to whose limbs they are on."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.truth import truth_tracks
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import whole
from voodoo_jax.records.scene import Scene, Subject
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import in_one_picture, simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.icp.misfit import AROUND, body_distance
from voodoo_jax.trackers.icp.people import close_in, owned_in_turn, touching_in

COUNT, RATE, STOLEN = 24, 15.0, 10
SCENE = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)


@pytest.fixture(scope="module")
def reaching(tmp_path_factory):
    """Two people beside each other, both turned to the camera; one reaches in front of the other. Their simulations,
    the frames' points, and whose each of these is."""
    time = np.arange(COUNT) / RATE
    swing = np.radians(np.interp(time, [0.4, 1.0], [0, -85]))
    turns = {"l_shoulder": np.outer(swing, [0.75, 0.65, 0]).astype(np.float32)}
    people = []
    for stature, moves, x, y in ((1.82, turns, 3.02, 0.28), (1.66, {}, 3.15, -0.22)):
        body = scaled(human(), stature)
        motion = placed(motion_of_turns(body, time, moves), x, y, np.pi)
        people.append(simulate(body, motion, tof_camera(1.2, 0.0), room=None))
    path = write_simulation(in_one_picture(*people), tmp_path_factory.mktemp("reaching") / "reaching.mcap")
    frames = [whole(frame) for frame in read_log(path).frames]
    owner = []
    for at, frame in enumerate(frames):
        sizes = [np.asarray(p.body.sizes, np.float32) for p in people]
        off = [body_distance(s, p.rotation[at], p.translation[at], frame.points) for s, p in zip(sizes, people)]
        owner.append(np.argmin(off, 0))
    return people, frames, owner


def shared(reaching, stolen: bool):
    """What each is given of frames in which the second one has the first one's arm from some frame on, if `stolen`;
    the share of points that are with whom they belong to, [frame]: as given and as found."""
    people, frames, owner = reaching
    arm = [people[0].body.topology.limbs.index(f"l_{name}") for name in ("forearm", "hand")]
    sizes = np.asarray(people[0].body.sizes, np.float32)[arm]
    given = []
    for at, frame in enumerate(frames):
        mine = np.array(owner[at])
        if stolen and at >= STOLEN:
            place = people[0].rotation[at, arm], people[0].translation[at, arm]
            mine[body_distance(sizes, *place, frame.points) < 0.05] = 1
        given.append(mine)
    subjects = [Subject(k + 1, SCENE, [f.only(m == k) for f, m in zip(frames, given)]) for k in (0, 1)]
    tracks = [replace(truth_tracks(p), status=np.full(COUNT, Status.TRACKED, np.int8)) for p in people]
    found = owned_in_turn(subjects, tracks, close_in(tracks), Settings(), AROUND)
    right = []
    for at, frame in enumerate(frames):
        theirs = [set(map(bytes, own[at].points)) for own in found]
        assert sum(map(len, theirs)) == len(set(map(bytes, frame.points)))  # nothing twice, nothing lost
        right.append(np.mean([bytes(p) in theirs[k] for p, k in zip(frame.points, owner[at])]))
    return np.array([np.mean(g == o) for g, o in zip(given, owner)]), np.array(right)


def test_an_arm_that_somebody_else_was_given_comes_back(reaching):
    given, found = shared(reaching, stolen=True)
    late = slice(STOLEN, None)
    assert given[late].min() < 0.95
    # at the limbs' surfaces, where both are as near, noise decides
    assert found[late].mean() > 0.985 and (1 - found[late]).mean() < 0.3 * (1 - given[late]).mean()


def test_who_has_their_own_points_keeps_them(reaching):
    given, found = shared(reaching, stolen=False)
    assert np.all(given == 1) and found.mean() > 0.985


def test_people_are_close_where_their_points_may_be_mixed_up(reaching):
    people, frames, owner = reaching
    subjects = [Subject(k + 1, SCENE, [f.only(m == k) for f, m in zip(frames, owner)]) for k in (0, 1)]
    tracks = [truth_tracks(p) for p in people]
    found = touching_in(subjects, tracks, np.ones((2, COUNT), bool))
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0, -5:].all()  # the arm is before the other one's chest
    alone = touching_in(subjects, tracks, np.zeros((2, COUNT), bool))
    assert not alone.any()


def test_who_is_far_from_the_other_is_left_alone(reaching):
    people, frames, owner = reaching
    subjects = [Subject(k + 1, SCENE, [f.only(m == k) for f, m in zip(frames, owner)]) for k in (0, 1)]
    away, (one, two) = np.float32([0, -3, 0]), map(truth_tracks, people)
    tracks = [one, replace(two, translation=two.translation + away, joints=two.joints + away)]
    close = close_in(tracks)
    assert not close.any()
    found = owned_in_turn(subjects, tracks, close, Settings(), AROUND)
    assert all(now is before for own, s in zip(found, subjects) for now, before in zip(own, s.frames))
