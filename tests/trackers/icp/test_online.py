"""No look into the future: what comes later changes nothing in the frames before."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings
from voodoo_jax.config.presets import online
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.of_points import track_person

SETTINGS = online(Settings())
CUT = 60


@pytest.fixture(scope="module")
def demo() -> tuple[Scene, list[BodyObservation], list[BodyObservation]]:
    """Floor and walls, the person in the demo's frames, and in the first of them alone."""
    source = open_log(str(files("voodoo_jax") / "data" / "demo.mcap"))
    frames = [frame for frame, _ in zip(source.frames(), range(90))]
    scene, people = find_body(frames, source.up, human(), SETTINGS)
    again, first = find_body(frames[:CUT], source.up, human(), SETTINGS)
    assert again.floor.normal.tolist() == scene.floor.normal.tolist()
    return scene, people, first


def tracks_of(scene: Scene, people: list[BodyObservation]) -> Tracks:
    return track_person(Task(human(), LogInfo("demo", "base"), SETTINGS), scene, people)


def same(whole: Tracks, cut: Tracks) -> None:
    count = len(cut.time_ns)
    assert np.array_equal(whole.status[:count], cut.status)
    for name in ("joints", "rotation", "translation", "joint_confidence", "joint_covariance"):
        np.testing.assert_allclose(getattr(whole, name)[:count], getattr(cut, name), rtol=1e-4, atol=1e-5, err_msg=name)


def test_the_person_is_told_by_what_came_before(demo):
    _, people, first = demo
    assert len(first) == CUT
    for whole, cut in zip(people, first):
        np.testing.assert_array_equal(whole.points, cut.points)
        assert whole.noise == cut.noise


def test_later_frames_change_nothing(demo):
    scene, people, first = demo
    whole = tracks_of(scene, people)
    assert whole.tracked.all()
    same(whole, tracks_of(scene, first))


def test_who_goes_and_comes_back(demo):
    """How long the body stays away is not known in the frames in which it goes; it is found when it comes back."""
    scene, people, _ = demo
    none = np.zeros(0, int)
    gone = [f.only(none) if 30 <= k < 62 else f for k, f in enumerate(people)]
    whole = tracks_of(scene, gone)
    assert (whole.status[30:62] == Status.NO_DATA).all() and whole.tracked[:30].all() and whole.tracked[62:].all()
    patience = SETTINGS.track.patience
    known = np.isfinite(whole.joints).all((1, 2))
    assert known[: 30 + patience].all() and not known[30 + patience : 62].any()
    for cut in (35, 30 + patience + 3, CUT):
        same(whole, tracks_of(scene, gone[:cut]))


def test_a_start_in_doubt_is_made_good(demo):
    """A cupboard beside the person, taken for a part of them: the eye tells most of it apart. Once it is gone, size and
    pose are found anew."""
    scene, people, _ = demo
    middle = np.median(people[0].points, 0)
    grid = np.stack(np.meshgrid(np.linspace(-0.35, 0.35, 18), np.linspace(0.05, 1.3, 30)), -1).reshape(-1, 2)
    front = np.stack([0 * grid[:, 0], grid[:, 0] + 0.5, grid[:, 1]], 1) + [middle[0], middle[1], 0.0]
    count = len(front)
    beside = [
        replace(
            f,
            points=np.concatenate([f.points, front.astype(np.float32)]),
            sensor=np.concatenate([f.sensor, np.zeros(count, f.sensor.dtype)]),
            weight=None if f.weight is None else np.concatenate([f.weight, np.ones(count, np.float32)]),
        )
        if k < 40
        else f
        for k, f in enumerate(people)
    ]
    usual, found = tracks_of(scene, people), tracks_of(scene, beside)
    assert float(found.body.scale) == pytest.approx(float(usual.body.scale), rel=0.02)
    apart = np.linalg.norm(found.joints - usual.joints, axis=2)
    assert apart[:40].mean() < 0.03 and apart[62:].max() < 0.06
    assert found.tracked[62:].all() and (found.status[:30] == Status.LOST).all()


def test_the_command(tmp_path, capsys):
    log = str(files("voodoo_jax") / "data" / "demo.mcap")
    assert main(["replay", log, "--out", str(tmp_path), "--online", "--smooth", "0.1"]) == 2
    assert "--online" in capsys.readouterr().err
    assert SETTINGS == vj.online(Settings()) == replace(Settings(), online=True)


@pytest.mark.parametrize("settings", [SETTINGS, Settings()], ids=["online", "both ways"])
def test_something_else_is_the_body_from_some_frame_on(demo, settings):
    """At first a larger thing is followed, then the person, as if nothing had been before."""
    scene, people, _ = demo
    larger = [replace(frame, points=frame.points * np.float32(1.2)) for frame in people[:30]]
    later = people[30:60]
    whole, alone = (
        track_person(Task(human(), LogInfo("demo", "base"), settings), scene, frames)
        for frames in ([*larger, replace(later[0], other=True), *later[1:]], later)
    )
    assert whole.tracked[30:].all()
    apart = np.linalg.norm(whole.joints[30:] - alone.joints, axis=-1)
    assert np.median(apart) < 1e-3 and apart.max() < 0.05  # forearms' length is found from all frames
    assert abs(float(whole.body.scale) - float(alone.body.scale)) < 1e-3


def test_something_else_after_nothing_at_all(demo):
    """The larger thing is lost before something else is taken: it begins with a size of its own all the same."""
    scene, people, _ = demo
    larger = [replace(frame, points=frame.points * np.float32(1.2)) for frame in people[:25]]
    gap = [frame.only(np.zeros(len(frame.points), bool)) for frame in people[25:50]]
    gap[20] = replace(gap[20], other=True)
    found, alone = (tracks_of(scene, frames) for frames in ([*larger, *gap, *people[50:80]], people[50:80]))
    assert abs(float(found.body.scale) - float(alone.body.scale)) < 1e-3
