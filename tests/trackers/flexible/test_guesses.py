"""The body in single frames, as the learned eye sees it, and hypotheses that begin anew from there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import voodoo_jax as vj
from tests.support.waving import SMALL, waving_log
from tests.trackers.flexible.test_scores import NUMBERS, context, view
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.kernels.eye import JOINTS, OTHER
from voodoo_jax.model.body import joint_centres
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.flexible import guesses, tracker
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, LIMBS, OTHER_SIDE, POINTS, flexible_body
from voodoo_jax.trackers.flexible.scores import Guess, limb_score, log_weight, sided
from voodoo_jax.trackers.flexible.vectors import vectors
from voodoo_jax.trackers.shared.eye import Seen

NOBODY = BodyObservation(0, np.zeros((0, 3), np.float32), np.zeros(0, int), np.zeros((1, 3), np.float32))
FLOOR = Plane(np.array([0, 0, 1], np.float32), 0.0)
BODY = vj.human()
CENTRE = np.asarray(joint_centres(BODY, BODY.rest))[[BODY.topology.centres.index(name) for name in JOINTS]]
REST = np.asarray(flexible_body(BODY, float(BODY.scale)).rest)


def said(front: tuple[float, float, float], spread: float = 0.1, other: bool = False) -> Seen:
    return Seen(CENTRE[OTHER] if other else CENTRE, np.full(len(JOINTS), spread), np.array(front), np.ones(1))


def looked(monkeypatch: pytest.MonkeyPatch, each: list[Seen | None]) -> dict[int, np.ndarray]:
    told = iter(each)
    monkeypatch.setattr(guesses, "seen", lambda person, floor: next(told))
    found = guesses.Guesses(REST)
    for row in range(len(each)):
        found.look(row, NOBODY, FLOOR)
    return {row: guess.x for row, guess in found.place.items()}


def test_points_are_where_the_joints_are(monkeypatch):
    (place,) = looked(monkeypatch, [said((5, 0, 0))]).values()
    for name, centre in CENTRES.items():
        np.testing.assert_allclose(place[POINTS.index(name)], CENTRE[JOINTS.index(centre)], atol=1e-6)
    waist = POINTS.index("l_waist")
    assert place[POINTS.index("l_hip"), 2] < place[waist, 2] < place[POINTS.index("l_shoulder"), 2]


def test_one_frame_that_is_taken_for_its_back_does_not_turn_the_body(monkeypatch):
    front, back = said((3, 0, 0)), said((-2, 0, 0), other=True)
    place = looked(monkeypatch, [front, front, back, front])
    np.testing.assert_allclose(place[2], place[0], atol=1e-6)
    # but more of them do
    place = looked(monkeypatch, [front, *[said((-4, 0, 0), other=True)] * 6])
    np.testing.assert_allclose(place[6], place[0][OTHER_SIDE], atol=1e-6)


def test_what_the_eye_is_not_sure_of_is_no_guess(monkeypatch):
    assert list(looked(monkeypatch, [said((5, 0, 0)), said((5, 0, 0), spread=1.0), None])) == [0]


def test_an_ankle_that_nothing_shows_is_where_the_eye_sees_it():
    """A leg folded behind itself costs no more than a straight one by what is seen of it."""
    guess = jax.tree.map(jnp.asarray, Guess(REST, np.full(16, 0.08, np.float32), np.float32(3)))
    leg = np.repeat(REST[LIMBS[2], None], 2, 1)
    leg[2, 1] = leg[1, 0] + 0.9 * (leg[0, 0] - leg[1, 0]) - [0.1, 0, 0]
    blind = context((0.0, 0.0, 0.0), np.zeros((4, 3)))
    for body in (REST, REST[OTHER_SIDE]):
        own, error, log = sided(guess, jnp.asarray(body))
        seen = blind._replace(guess=own[LIMBS[2]], error=error[LIMBS[2]])
        points = vectors(leg[0]), vectors(leg[1]), vectors(leg[2])
        weight = log_weight(limb_score(points, seen, view(0.0), NUMBERS.weighing), NUMBERS.weighing)
        np.testing.assert_allclose(own, body, atol=1e-6)
        np.testing.assert_allclose(log, -np.logaddexp(0, -3 if body is REST else 3), rtol=1e-5)
        assert body is not REST or weight[0] > weight[1] + 1


def test_what_begins_turned_round_is_found_again(tmp_path, monkeypatch):
    path, truth = waving_log(tmp_path, 28)
    recording = read_log(path, vj.preset("flexible").read)
    begin = tracker.first_pose
    monkeypatch.setattr(tracker, "first_pose", lambda *given: begin(*given)[OTHER_SIDE])
    wrong = []
    for guessed in (True, False):
        if not guessed:
            monkeypatch.setattr(guesses.Guesses, "look", lambda *_: None)
        tracks = vj.track(vj.human(), recording, Settings(tracker="flexible", flexible=SMALL))
        wrong.append(np.nanmean(np.linalg.norm(tracks.joints - truth, axis=-1)[8:]))
    assert wrong[0] < 0.08 and wrong[0] < 0.7 * wrong[1]
