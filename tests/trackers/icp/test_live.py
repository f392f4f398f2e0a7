"""Frames that come one by one are tracked as a whole recording is, and nothing that was given out is revised."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from tests.trackers.icp.test_online import SETTINGS as ONLINE
from voodoo_jax.config.options import Change, Settings, SettingsError
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.icp import live, sequence
from voodoo_jax.trackers.icp.initialise import begin
from voodoo_jax.trackers.icp.live import LiveTracker
from voodoo_jax.trackers.icp.refine.choose_facing import EVERY, turned_round
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis
from voodoo_jax.trackers.of_points import track_person

# as long as the program of a live tracker: one is compiled for both
SETTINGS = replace(ONLINE, track=replace(ONLINE.track, chunk=12, patience=5))
NOT_COMPARED = {"seconds", "compile_seconds", "body", "notes", "source", "fixed_frame"}
NONE = np.zeros(0, int)


@pytest.fixture(scope="module")
def demo() -> tuple[Scene, list[BodyObservation]]:
    """Floor and walls, and the person in the demo's first frames."""
    source = open_log(str(files("voodoo_jax") / "data" / "demo.mcap"))
    frames = [frame for frame, _ in zip(source.frames(), range(76))]
    return find_body(frames, source.up, human(), ONLINE)


def followed(scene: Scene, people: list[BodyObservation]) -> tuple[Tracks, list[list[Tracks]]]:
    """The whole, and what was given out after each frame."""
    tracker = LiveTracker(human(), SETTINGS, people[:1], scene)
    given = [tracker.add(frame, scene) for frame in people]
    given.append(tracker.end())
    return tracker.whole(LogInfo("demo", "base")), given


def compared(scene: Scene, people: list[BodyObservation], resized: int = 0) -> tuple[Tracks, list[list[Tracks]]]:
    """Whole and given are what a replay makes of it; but for joints before the frame from which on the body has the
    size that it has at last."""
    wanted = track_person(Task(human(), LogInfo("demo", "base"), SETTINGS), scene, people)
    whole, given = followed(scene, people)
    every = [one for some in given for one in some]
    assert len(every) == len(people) and float(whole.body.scale) == float(wanted.body.scale)
    np.testing.assert_array_equal(whole.up, wanted.up)
    for name, value in wanted.rows().items():
        if name in NOT_COMPARED:
            continue
        np.testing.assert_array_equal(whole.rows()[name], value, err_msg=name)
        shown = np.concatenate([one.rows()[name] for one in every])
        np.testing.assert_allclose(shown[resized:], value[resized:], rtol=1e-4, atol=1e-5, err_msg=name)
        if name == "joints":
            np.testing.assert_allclose(shown, value, atol=0.01)
    return whole, given


def test_who_goes_and_comes_back(demo):
    scene, people = demo
    gone = [frame.only(NONE) if 22 <= k < 40 or k < 3 else frame for k, frame in enumerate(people)]
    whole, given = compared(scene, gone[:52])
    assert (whole.status[:3] == Status.NOT_STARTED).all() and (whole.status[22:40] == Status.NO_DATA).all()
    assert whole.tracked[3:22].all() and whole.tracked[40:].all()
    # once it has begun each frame is given at once; a start waits for its trials
    waits = SETTINGS.start.size_frames
    counts = [len(some) for some in given]
    assert counts[:3] == [1, 1, 1] and sum(counts[3 : 3 + waits - 1]) == 0 and counts[2 + waits] == waits
    assert all(count == 1 for count in counts[3 + waits : 40]) and counts[-1] == 0


def test_something_else_becomes_the_body(demo):
    scene, people = demo
    larger = [replace(frame, points=frame.points * np.float32(1.1)) for frame in people[:26]]
    later = people[26:52]
    whole, _ = compared(scene, [*larger, replace(later[0], other=True), *later[1:]], 27)
    assert whole.tracked[26:].all()


def test_a_start_in_doubt_and_one_that_is_lost(demo):
    """A cupboard beside the person, taken for a part of them, and far too little of them afterwards."""
    scene, people = demo
    middle = np.median(people[0].points, 0)
    grid = np.stack(np.meshgrid(np.linspace(-0.35, 0.35, 18), np.linspace(0.05, 1.3, 30)), -1).reshape(-1, 2)
    front = np.stack([0 * grid[:, 0], grid[:, 0] + 0.5, grid[:, 1]], 1) + [middle[0], middle[1], 0.0]

    def beside(frame: BodyObservation) -> BodyObservation:
        points = np.concatenate([frame.points, front.astype(np.float32)])
        sensor = np.concatenate([frame.sensor, np.zeros(len(front), frame.sensor.dtype)])
        return replace(frame, points=points, sensor=sensor, weight=None)

    def cut(frame: BodyObservation) -> BodyObservation:
        moved = frame.points + np.float32([0.0, 1.5, 0.0])
        return replace(frame, points=moved)

    seen = [beside(f) if k < 33 else f if k < 50 else cut(f) for k, f in enumerate(people)]
    whole, _ = compared(scene, seen)
    assert (whole.status[:30] == Status.LOST).all() and whole.tracked[56:].all()


def test_who_is_begun_back_to_front_is_turned(demo, monkeypatch):
    scene, people = demo

    def turned(run: Runner, at: int, before: Poses | None) -> StartHypothesis:
        start = begin(run, at, before)
        run.facing = 1.0  # the eye is not asked before the next look is due
        return start._replace(poses=turned_round(start.poses, run.scene.floor.normal))

    people = [people[0].only(NONE), *people[1:30]]  # it begins after the first look
    usual = track_person(Task(human(), LogInfo("demo", "base"), SETTINGS), scene, people)
    for module in (live, sequence):
        monkeypatch.setattr(module, "begin", turned)
    whole, _ = compared(scene, people)
    apart = np.linalg.norm(whole.joints - usual.joints, axis=-1).mean(1)
    assert apart[1:EVERY].min() > 0.1 and apart[EVERY + 3 :].max() < 0.05


def test_settings_that_need_what_is_not_there_yet(demo):
    scene, people = demo
    with pytest.raises(SettingsError, match="online"):
        LiveTracker(human(), Settings(), people[:1], scene)
    with pytest.raises(SettingsError, match="changes of the body"):
        LiveTracker(human(), replace(SETTINGS, changes=(Change(1.0, scale=1.7),)), people[:1], scene)
