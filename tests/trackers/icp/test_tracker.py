"""A whole recording: people who come late, leave and return, frames without points, empty recordings."""

from dataclasses import replace
from itertools import cycle
from threading import Thread

import jax
import jax.monitoring
import numpy as np
import pytest

from voodoo_jax.compile.executable import forget
from voodoo_jax.config.options import DetectSettings, Settings, TrackSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.recording import Frame, Rays, Recording
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import render, simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import TOF_NOISE, add_noise, tof_camera
from voodoo_jax.solve.scan import track_visits
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.front import track
from voodoo_jax.trackers.icp.tracker import prepare
from voodoo_jax.trackers.shared.report import looked_at
from voodoo_jax.trackers.shared.runner import first_run

CAMERA = tof_camera(1.0, 0.07)
NO, YES, GONE = Status.NOT_STARTED, Status.TRACKED, Status.NO_DATA


@pytest.fixture(scope="module")
def standing():
    """A person who stands still: the recording as read from a log, and the truth."""
    body = scaled(human(), 1.83)
    return simulate(body, placed(make_motion(body, "stand", 1.2, 10.0), 3.6, 0.0, np.pi), CAMERA)


@pytest.fixture(scope="module")
def recording(standing, tmp_path_factory) -> Recording:
    return read_log(write_simulation(standing, tmp_path_factory.mktemp("sim") / "stand.mcap"))


@pytest.fixture(scope="module")
def nobody(standing, tmp_path_factory) -> list[Frame]:
    """The same room without the person."""
    body = standing.body
    behind = Poses(body.rest.rotation, body.rest.translation - np.array([50.0, 0, 0], np.float32))
    exact = render(body, behind, CAMERA, Room())
    images = np.stack([add_noise(*exact, CAMERA, TOF_NOISE, np.random.default_rng(i)) for i in range(4)])
    few = {name: getattr(standing, name)[:4] for name in ("time_ns", "rotation", "translation", "joints")}
    empty = replace(standing, depth=images, **few)
    return list(read_log(write_simulation(empty, tmp_path_factory.mktemp("sim") / "empty.mcap")).frames)


def test_a_single_scan_is_tracked(standing, recording):
    one = track(human(), replace(recording, frames=recording.frames[3:4]))
    assert one.status.tolist() == [YES] and len(one.time_ns) == len(one.joint_confidence) == 1
    assert one.time_ns[0] == recording.frames[3].time_ns
    assert np.linalg.norm(one.joints[0] - standing.joints[3], axis=-1).mean() < 0.03


def joined(recording: Recording, *parts: list[Frame]) -> Recording:
    """The frames one after the other, at new stamps."""
    frames = [f for part in parts for f in part]
    stamped = tuple(replace(f, time_ns=10**18 + 100_000_000 * i) for i, f in enumerate(frames))
    return replace(recording, frames=stamped)


def check(tracks, expected: list[Status], standing, mean: float = 0.02) -> None:
    """Status frame by frame, and the joint error where the person is tracked."""
    assert [Status(int(s)) for s in tracks.status] == expected
    error = np.linalg.norm(tracks.joints - standing.joints[0], axis=-1)[tracks.tracked]
    assert error.mean() < mean and np.percentile(error, 99) < 0.06
    # a short absence is bridged by the prediction; of a long one nothing is said
    gone = np.array(expected) == GONE
    known = (np.array(expected) == YES) | (gone & (gone.sum() < Settings().track.patience))
    assert np.isfinite(tracks.joints[known]).all() and np.isnan(tracks.joints[~known]).all()


def test_a_person_who_comes_late(recording, nobody, standing):
    frames = list(recording)
    tracks = track(human(), joined(recording, nobody * 4, frames))
    check(tracks, [NO] * 16 + [YES] * len(frames), standing)
    assert abs(float(tracks.body.scale) - 1.83) < 0.025  # sized from the frames in which there is somebody


@pytest.mark.parametrize("away", [2, 16, 44])
def test_a_person_who_leaves_and_returns(recording, nobody, standing, away):
    """Shorter than the tracker's patience, longer, and longer than the finder remembers the place."""
    frames = list(recording)
    # the same frames once more: nobody stands as still as that
    settings = Settings(detect=DetectSettings(skip=("drop_motionless",)))
    tracks = track(human(), joined(recording, frames, (nobody * 11)[:away], frames), settings)
    check(tracks, [YES] * len(frames) + [GONE] * away + [YES] * len(frames), standing)


def test_a_person_who_leaves_for_good(recording, nobody, standing):
    frames = list(recording)
    tracks = track(human(), joined(recording, frames, nobody * 6))
    check(tracks, [YES] * len(frames) + [GONE] * 24, standing)


def test_a_frame_without_points(recording, standing):
    frames = list(recording)
    hole = replace(frames[5], points=frames[5].points[:0], sensor=frames[5].sensor[:0])
    tracks = track(human(), joined(recording, frames[:5], [hole], frames[6:]))
    check(tracks, [YES] * 5 + [GONE] + [YES] * (len(frames) - 6), standing)
    assert tracks.evidence.points[5] == 0 and tracks.evidence.explained[5] == 0
    # the prediction stands in: nobody jumps in a tenth of a second
    assert np.linalg.norm(tracks.joints[5] - standing.joints[5], axis=-1).max() < 0.06


def test_nobody_and_nothing(recording, nobody):
    done = []
    tracks = track(human(), joined(recording, nobody * 3), progress=done.append)
    assert not tracks.tracked.any() and np.isnan(tracks.joints).all() and sum(done) == 12
    assert any("no frame is tracked" in note for note in tracks.notes)
    tracks = track(human(), joined(recording))
    assert len(tracks.time_ns) == 0 and tracks.joints.shape == (0, 14, 3)


def test_progress_counts_every_frame_once(recording, nobody):
    done = []
    frames = list(recording)
    log = joined(recording, nobody, frames, nobody * 5, frames[:6])
    track(human(), log, Settings(track=TrackSettings(skip=("looks_ahead",))), progress=done.append)
    assert sum(done) == 4 + len(frames) + 20 + 6 and min(done) >= 0
    done.clear()
    track(human(), log, progress=done.append)
    assert sum(done) > len(log) + len(frames)  # and once more backwards where somebody was


FEATURES, MANY = {("face",), ("left_hand", "face")}, {("skin",) * 9}


@pytest.mark.parametrize(
    ("sensors", "parts", "names"),
    [(1, False, set()), (2, True, set()), (1, False, FEATURES), (1, False, {("skin",) * 9})],
)
def test_what_is_prepared_is_what_is_used(recording, sensors, parts, names):
    """Whatever is known of a log before it is read suffices to compile what tracks it."""
    body, settings = human(), Settings()
    said = cycle(sorted(names) or [()])
    ahead = lambda f, name: np.tile((f.points.mean(0) - f.origins[0])[None], (len(name), 1))  # noqa: E731
    frames = [
        replace(
            f,
            origins=np.repeat(f.origins[:1], sensors, 0),
            part=np.full(len(f.points), -1, np.int32) if parts else None,
            parts=("body",) if parts else (),
            rays=Rays(
                name, np.tile(f.origins[:1], (len(name), 1)), ahead(f, name), np.full(len(name), 1e-6, np.float32)
            ),
        )
        for f, name in zip(recording, said)
    ]
    forget()
    for thread in prepare(Task(body, LogInfo(sensors=sensors, names=names, parts=parts), settings)):
        thread.join()
    made = [set(p.ready) for p in (track_visits, looked_at)]
    assert [len(keys) for keys in made] == [1, 1]
    tracks = track(body, replace(joined(recording, frames), sensors=recording.sensors * sensors), settings)
    assert tracks.tracked.all() and tracks.compile_seconds < 0.5
    assert [set(p.ready) for p in (track_visits, looked_at)] == made


def test_what_another_thread_compiles_meanwhile_takes_no_time_from_tracking(recording, nobody):
    def compiles(seconds: float) -> None:
        jax.monitoring.record_event_duration_secs("/jax/core/compile/backend_compile_duration", seconds)

    def meanwhile(_: int) -> None:
        compiles(1e-6)  # a time that has passed
        elsewhere = Thread(target=compiles, args=(1000.0,))
        elsewhere.start()
        elsewhere.join()

    tracks = track(human(), joined(recording, nobody * 3), progress=meanwhile)
    assert tracks.seconds > 0 and 0 < tracks.compile_seconds < 1000


@pytest.mark.parametrize(
    ("mask", "length", "at"),
    [("0110111", 3, 4), ("0110111", 2, 1), ("0110", 3, 4), ("", 2, 0), ("1", 1, 0), ("11", 3, 2), ("111", 3, 0)],
)
def testfirst_run(mask, length, at):
    assert first_run(np.array([c == "1" for c in mask], bool), length) == at
