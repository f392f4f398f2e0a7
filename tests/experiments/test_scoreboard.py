"""How the scoreboard scores people, turns and cases, on examples made by hand."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import voodoo_jax as vj
from experiments.scoreboard.board import Data
from experiments.scoreboard.cases import (
    CaseFound,
    Check,
    Either,
    Found,
    Near,
    Nobody,
    Place,
    Refused,
    make,
    wrong_unsaid,
)
from experiments.scoreboard.kept import merged, page_text
from experiments.scoreboard.people_score import Counts, counted, figures, score_people
from experiments.scoreboard.promises import field_cases, real_sensors
from experiments.scoreboard.run import measure
from voodoo_jax.records.tracks import Status


@dataclass(frozen=True)
class Asked:
    """A case that is judged already."""

    name: str
    wrong: str

    def run(self) -> CaseFound:
        return CaseFound(self.name, self.wrong, 0)


START, STEP = 1_700_000_000_000_000_000, 66_666_667
NAMES = vj.human().topology.centres


def tracks_at(joints: np.ndarray, tracked=True, sure: float = 0.95) -> vj.Tracks:
    """Tracks with these joints [frame, joint, 3], metres."""
    count, body = len(joints), vj.human()
    limbs = np.zeros((count, body.limb_count, 4), np.float32)
    status = np.where(np.broadcast_to(tracked, count), Status.TRACKED, Status.LOST).astype(np.int8)
    return vj.Tracks(
        "log", "base", body, START + STEP * np.arange(count), limbs, limbs[..., :3], joints.astype(np.float32), status,
        vj.Evidence.blank(count, body.limb_count), joint_confidence=np.full(joints.shape[:2], sure, np.float32),
    )  # fmt: skip


def standing(x: float, frames: int = 30) -> np.ndarray:
    """Somebody who stands at x, metres."""
    body = np.random.default_rng(3).normal(0, 0.3, (len(NAMES), 3)) + [x, 0, 1]
    return np.broadcast_to(body, (frames, *body.shape)).copy()


def write_truth(path: Path, joints: np.ndarray, **more) -> Path:
    stamps = START + STEP * np.arange(joints.shape[-3])
    np.savez(path, time_ns=stamps, joints=joints, names=np.array(NAMES), **more)
    return path


def test_people_are_paired_one_to_one_and_kept():
    """Frames: both found; tracks swapped; only one claims; a claim on nobody; one hidden."""
    away = np.full((2, 2, 5), np.inf)  # [tracks, person, time]
    away[0, 0, 0] = away[1, 1, 0] = 0.1
    away[1, 0, 1] = away[0, 1, 1] = 0.2
    away[0, 0, 1] = away[1, 1, 1] = 0.9  # too far to stay paired
    away[1, 0, 2], away[1, 1, 2] = 0.3, 0.05  # stays with whom it was paired, though another is nearer
    away[0, 0, 3], away[0, 1, 3] = 0.7, 0.8
    away[1, 0, 4] = away[0, 1, 4] = 0.1
    seen = np.ones((2, 5), bool)
    seen[1, 4] = False
    got = counted(away, seen)
    assert got._replace(error=0) == Counts(9, 6, 0, 1, 2, 4, 7)
    assert got.error == pytest.approx(0.1 + 0.1 + 0.2 + 0.2 + 0.3 + 0.1)
    shown = figures([got, Counts(1, 0, 0.0, 0, 0, 0, 0)])
    assert shown["found, %"] == 60 and shown["false, %"] == 10 and shown["joints, cm"] == pytest.approx(100 / 6)
    assert shown["idf1, %"] == pytest.approx(100 * 2 * 4 / (7 + 10))


def test_who_claims_nothing_finds_nobody(tmp_path):
    people = np.stack([standing(2.0), standing(4.0)])
    truth = write_truth(tmp_path / "two.truth.npz", people, pixels=np.full((2, 30), 900))
    scored = 30 - 8  # half a second is left out
    silent = tracks_at(people[0], tracked=False)
    assert score_people([silent], truth) == Counts(2 * scored, 0, 0.0, 0, 0, 0, 0)
    both = score_people([tracks_at(people[1] + [0.03, 0, 0]), tracks_at(people[0])], truth)
    assert both.paired == both.visible == both.same == 2 * scored and both.false == both.switches == 0
    assert both.error == pytest.approx(0.03 * scored, rel=1e-3)
    stranger = score_people([tracks_at(standing(9.0))], truth)
    assert stranger.paired == 0 and stranger.false == scored


def place_with(tmp_path: Path, **found: Found) -> Place:
    """A place in which logs have been tracked already."""
    write_truth(tmp_path / "me.truth.npz", standing(2.0))
    return Place(tmp_path, tmp_path, {(log, 0): one for log, one in found.items()})


def test_a_case_is_right_where_somebody_is_near_enough(tmp_path):
    there = tracks_at(standing(2.0) + [0.02, 0, 0])
    arm = there.joints.copy()
    arm[:, NAMES.index("l_elbow")] += 0.5
    place = place_with(
        tmp_path,
        good=Found((there,), ("one", "two"), ""),
        arm=Found((replace(there, joints=arm),), (), ""),
        half=Found((tracks_at(there.joints, np.arange(30) % 2 == 0),), (), ""),
        two=Found((tracks_at(standing(9.0)), there), (), ""),
        utm=Found((replace(tracks_at(there.joints + [1000.0, 0, 0]), fixed_frame="utm"),), (), ""),
    )
    wrong = lambda log, limit=3.0, **more: Near(log, "me.truth.npz", limit, **more).wrong(place)  # noqa: E731
    assert wrong("good") == "" and "2.0 cm" in wrong("good", 1.9)
    assert "cm" in wrong("arm") and wrong("arm", joints=("r_elbow",)) == ""
    assert "said right 95 %, are 0 %" in wrong("arm", joints=("r_elbow",), doubtful=("l_elbow",))
    assert "50 % tracked" in wrong("half") and wrong("half", tracked=0.4) == ""
    assert "50 % tracked" not in wrong("half", tracked=0.4, at_most=0.6)
    assert wrong("two", people=2) == "" and "1 of 2 people" in wrong("good", people=2)
    assert "30 frames, not 31" in wrong("good", frames=31) and wrong("good", frames=30) == ""
    assert "2 notes" in wrong("good", notes=1) and "'wo'" in wrong("good", never="wo")
    assert "cm" in wrong("utm") and wrong("utm", frame="utm", at=(1000.0, 0.0, 0.0)) == ""


def test_a_case_is_right_where_the_log_is_refused_with_a_reason(tmp_path):
    there = Found((tracks_at(standing(2.0)),), ("Units look odd",), "")
    lost = Found((tracks_at(standing(2.0), tracked=False),), ("Units look odd",), "")
    place = place_with(tmp_path, shut=Found((), (), "The Unit is not known"), there=there, lost=lost)
    assert Refused("shut", ("unit",)).wrong(place) == "" and "scale" in Refused("shut", ("unit", "scale")).wrong(place)
    assert Refused("lost", ("units",)).wrong(place) == "" and "is tracked" in Refused("there", ("units",)).wrong(place)
    near = Near("shut", "me.truth.npz", 3.0)
    assert "refused" in near.wrong(place) and Either(near, Refused("shut", ("unit",))).wrong(place) == ""
    assert Nobody("lost").wrong(place) == "" and "100 % tracked" in Nobody("there").wrong(place)


@pytest.mark.parametrize("x, sure, count", [(2.0, 0.95, 0), (5.0, 0.95, 1), (5.0, 0.5, 0)])
def test_what_is_wrong_unsaid(tmp_path, x, sure, count):
    place = place_with(tmp_path, log=Found((tracks_at(standing(x), sure=sure),), (), ""))
    assert wrong_unsaid(place, [Near("log", "me.truth.npz", 3.0)]) == count
    claims = int(sure > 0.8)  # of nobody
    assert wrong_unsaid(place, [Nobody("log")]) == claims


def test_a_case_is_made_by_its_script_or_lies_there(tmp_path):
    case, made = tmp_path / "case", tmp_path / "made"
    case.mkdir()
    made.mkdir()
    (case / "a.trc").write_text("x")
    (case / "case.md").write_text("x")
    assert make(case, made) == "" and [p.name for p in made.iterdir()] == ["a.trc"]
    (case / "make.py").write_text("open('b.mcap', 'w').close()")
    assert make(case, made) == "" and (made / "b.mcap").exists()
    (case / "make.py").write_text("raise OSError('no recordings')")
    assert "no recordings" in make(case, made)


def test_cases_that_are_not_there_are_not_measured(tmp_path):
    assert field_cases.jobs(Data(None)) == [] and field_cases.jobs(Data(tmp_path)) == []
    assert real_sensors.jobs(Data(tmp_path)) == []


def test_what_is_behind_the_figures_is_shown_on_the_page():
    promise = replace(field_cases.PROMISE, jobs=lambda data: [Asked("a", ""), Asked("b", "0 % tracked")])
    (found,) = measure([promise], Data(None), 1)
    assert found.values["cases wrong"] == 1 and found.details == ("b: 0 % tracked",)
    assert "field_cases:\n\n* b: 0 % tracked\n" in page_text(merged({}, [found], False, True), [promise])


def test_where_somebody_faces_who_turns():
    quarter = np.eye(4)
    quarter[:3, :3] = [
        [0, 0, 1],
        [0, 1, 0],
        [-1, 0, 0],
    ]  # about y, down, by 90 degrees
    np.testing.assert_allclose(real_sensors.faced(np.eye(4)), [-1, 0])  # x forward: they face the camera
    np.testing.assert_allclose(real_sensors.faced(quarter), [0, -1])  # and then its right
    joints = standing(2.0, 1)
    joints[0, [NAMES.index("l_shoulder"), NAMES.index("r_shoulder")]] = [[2, -0.2, 1.4], [2, 0.2, 1.4]]
    facing = real_sensors.heading(tracks_at(joints), 0)
    assert real_sensors.turned(facing, np.array([-1.0, 0.0])) == pytest.approx(0)
    assert real_sensors.turned(facing, np.array([0.0, -1.0])) == pytest.approx(90)


def test_every_check_is_asked(tmp_path):
    assert all(isinstance(check, Check) for checks in field_cases.CASES.values() for check in checks)
    assert {*field_cases.CHEAP, *field_cases.CONTROLS} <= field_cases.CASES.keys()
