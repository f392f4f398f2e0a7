"""Pictures exist, are PNG, are not blank, and say when there is no pose."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.truth import truth_tracks
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.recording import Frame, Pairs, Recording
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import Camera
from voodoo_jax.viz.figures import picture, show

CAMERA = Camera(40, 31, 45.5, 43.1, 19.5, 15.0, (0.0, 0.0, 1.0), 0.07)


def simulated(name="human"):
    body = load_body(name)
    sim = simulate(body, placed(make_motion(body, "swing", 0.8, 5.0), 2.5, 0.0, np.pi), CAMERA)
    frames = []
    for stamp, image in zip(sim.time_ns.tolist(), sim.depth):
        z = image.reshape(-1, 1) / 1000
        points = (CAMERA.rays() * z + CAMERA.position)[z[:, 0] > 0].astype(np.float32)
        origins = np.array([CAMERA.position], np.float32)
        frames.append(Frame(stamp, points, np.zeros(len(points), np.int32), origins))
    up = np.array([0, 0, 1], np.float32)
    return sim, truth_tracks(sim), Recording("made.mcap", "base", up, ("/depth",), tuple(frames))


@pytest.mark.parametrize("name", ["human", "arm"])
def test_picture_is_a_png_with_something_on_it(tmp_path, name):
    from matplotlib.image import imread

    sim, tracks, recording = simulated(name)
    path = picture(tracks, recording, tmp_path / "p.png", frames=3, truth=sim.joints)
    assert path.read_bytes().startswith(b"\x89PNG") and [p.name for p in tmp_path.iterdir()] == ["p.png"]
    image = imread(path)[..., :3]
    assert 400 < image.shape[0] < 4000 and 400 < image.shape[1] < 4000
    coloured = np.ptp(image, axis=-1) > 0.2
    assert coloured.mean() > 0.005 and (image.min(-1) < 0.9).mean() > 0.02


def test_frames_without_pose_say_so():
    sim, tracks, recording = simulated()
    nowhere = np.full_like(tracks.translation, np.nan)
    status = np.full_like(tracks.status, Status.NOT_STARTED)
    none = tracks.having(
        translation=nowhere, rotation=tracks.rotation * np.nan, joints=tracks.joints * np.nan,
        status=status, residual=tracks.evidence.residual * np.nan,
    )  # fmt: skip
    figure = show(none, recording, frames=2)
    assert figure._repr_png_().startswith(b"\x89PNG")  # as a notebook asks for it
    texts = [t.get_text() for ax in figure.axes for t in ax.texts]
    assert texts == ["no pose"] * 4
    assert figure.axes[0].get_title() == "0.00 s, not started\nno residual"
    figure.draw_without_rendering()


def test_axes_have_equal_scale_and_frames_are_spread():
    _, tracks, recording = simulated()
    figure = show(tracks, recording, frames=99)
    assert len(figure.axes) == 3 * len(tracks.time_ns)
    assert all(ax.get_aspect() == 1 for ax in figure.axes)
    assert len({ax.get_ylim() for ax in figure.axes}) == 1


def test_frames_without_points_are_drawn():
    _, tracks, recording = simulated()
    empty = [replace(f, points=f.points[:0], sensor=f.sensor[:0], origins=f.origins[:0]) for f in recording]
    show(tracks, replace(recording, frames=tuple(empty)), frames=2).draw_without_rendering()


def test_nothing_to_draw_is_refused():
    sim, tracks, recording = simulated()
    with pytest.raises(ValueError, match="nothing to draw"):
        show(tracks, replace(recording, frames=()))
    with pytest.raises(ValueError, match="truth has 1 frames"):
        show(tracks, recording, truth=sim.joints[:1])


def test_markers_alone_are_drawn_without_an_empty_row_of_clouds():
    sim, tracks, recording = simulated()
    none = np.zeros((0, 3), np.float32)
    frames = [
        replace(f, points=none, sensor=f.sensor[:0], origins=none, pairs=Pairs(("a",) * len(joints), joints))
        for f, joints in zip(recording, sim.joints)
    ]
    figure = show(tracks, replace(recording, frames=tuple(frames), sensors=()), frames=3)
    assert len(figure.axes) == 2 * 3
    marks = [line for line in figure.axes[0].lines if line.get_marker() == "D"]
    assert len(marks) == 1 and len(marks[0].get_xdata()) == sim.joints.shape[1]
    assert "front" in figure.axes[0].get_ylabel() and "sensor" not in figure.axes[0].get_ylabel()
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"left", "right", "markers"}
    # seen from the front, the left shoulder is at the right
    joints = dict(zip(tracks.body.topology.centres, marks[0].get_xdata()))
    assert joints["l_shoulder"] > joints["r_shoulder"]
    figure.draw_without_rendering()


def test_the_window_follows_the_body_and_keeps_its_size():
    _, tracks, recording = simulated()
    aside = np.linspace(0, 6, len(tracks.time_ns), dtype=np.float32)[:, None, None] * np.array([0, 1, 0], np.float32)
    figure = show(replace(tracks, translation=tracks.translation + aside, joints=tracks.joints + aside), recording)
    columns = len(tracks.time_ns)
    widths = [np.ptp(ax.get_xlim()) for ax in figure.axes]
    np.testing.assert_allclose(widths, widths[0], rtol=1e-6)
    assert widths[0] < 3 and len({ax.get_ylim() for ax in figure.axes}) == 1
    middles = [np.mean(ax.get_xlim()) for ax in figure.axes[:columns]]
    assert abs(middles[-1] - middles[0]) > 3  # the view is not quite across


def test_left_is_warm_and_right_is_cool():
    _, tracks, recording = simulated()
    figure = show(tracks, recording, frames=1)
    patches = {
        text.get_text(): patch for text, patch in zip(figure.legends[0].get_texts(), figure.legends[0].get_patches())
    }
    left, right = (patches[side].get_facecolor() for side in ("left", "right"))
    assert left[0] > left[2] and right[2] > right[0]
    assert not show(*simulated("arm")[1:], frames=1).legends
