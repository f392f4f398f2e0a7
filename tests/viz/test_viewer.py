"""The viewer: bodies where they are tracked, in the scene and over the camera's image; tested without a browser."""

import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from tests.support.browser import in_browser
from tests.viz.test_picture import simulated
from voodoo_jax.cli.main import main
from voodoo_jax.exporters.npz import write_tracks_npz
from voodoo_jax.records.recording import Picture
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.viz.overlay import drawn_over
from voodoo_jax.viz.viewer import Viewer

K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])


def picture_of(tracks, i: int) -> Picture:
    """A black image of a camera that looks at the body from 3 m before it, from the sensor's side."""
    middle = np.nanmean(tracks.translation[i].astype(float), axis=0)
    T = np.eye(4)
    T[:3, :3] = np.array([[0, -1.0, 0], [0, 0, -1], [1, 0, 0]]).T  # looks along x, as the simulator's sensor
    T[:3, 3] = middle - [3.0, 0, 0]
    return Picture("/camera", 0, K, T, lambda: (np.zeros((240, 320, 3), np.uint8),))


def test_bodies_are_drawn_where_the_camera_sees_them():
    _, tracks, _ = simulated()
    picture = picture_of(tracks, 2)
    image = drawn_over(picture, [tracks], [2])
    rows, columns = np.nonzero(image.any(2))
    # all of the body, and nothing else
    joints = (tracks.joints[2] - picture.T_fixed_camera[:3, 3]) @ picture.T_fixed_camera[:3, :3] @ K.T
    pixel = joints[:, :2] / joints[:, 2:]
    assert rows.min() - 40 < pixel[:, 1].min() < rows.min() + 40 and abs(rows.max() - pixel[:, 1].max()) < 25
    assert columns.min() - 5 < pixel[:, 0].min() and pixel[:, 0].max() < columns.max() + 5
    # the left arm is orange (its red is strongest), the right one blue, where their wrists are
    near = {side: tracks.body.topology.centres.index(f"{side}_radiocarpal") for side in "lr"}
    for side, channel in (("l", 2), ("r", 0)):
        u, v = np.round(pixel[near[side]]).astype(int)
        patch = image[v - 8 : v + 9, u - 8 : u + 9].reshape(-1, 3).astype(int)
        assert patch[patch.any(1)].mean(0).argmax() == channel
    assert not drawn_over(picture, [tracks], [-1]).any()
    # from another origin it is the same
    moved = replace(tracks, translation=tracks.translation + np.float32(100))
    assert np.mean(drawn_over(picture, [moved], [2], np.full(3, 100.0)) != image) < 0.01


def test_the_scene_follows_the_frames():
    _, tracks, recording = simulated()
    frames = [replace(frame, pictures=(picture_of(tracks, i),)) for i, frame in enumerate(recording.frames)]
    recording = replace(recording, frames=tuple(frames))
    status = tracks.status.copy()
    status[2] = Status.LOST
    viewer = Viewer(recording, [replace(tracks, status=status), tracks.only(slice(3))], port=0)
    try:
        with urllib.request.urlopen(f"http://localhost:{viewer.server.get_port()}") as page:
            assert b"<html" in page.read().lower()
        viewer.show(2)
        assert "person 1: not tracked, residual" in viewer.said.content and viewer.picture is not None
        np.testing.assert_allclose(viewer.limbs[0][4].position, tracks.translation[2, 4], atol=1e-6)
        assert all(mesh.visible for mesh in viewer.limbs[1]) and viewer.picture.image.any()
        viewer.by.value = "confidence"
        viewer.show(3)
        assert "person 2: not here" in viewer.said.content and not any(mesh.visible for mesh in viewer.limbs[1])
    finally:
        viewer.server.stop()


def test_the_page_runs_in_a_browser(tmp_path):
    _, tracks, recording = simulated()
    viewer = Viewer(recording, [tracks], port=0)
    try:
        seen = in_browser(f"http://localhost:{viewer.server.get_port()}", tmp_path)
        assert "<canvas" in seen
    finally:
        viewer.server.stop()


def test_the_command(tmp_path, capsys):
    sim, tracks, _ = simulated()
    log = write_simulation(sim, tmp_path / "a.mcap")
    write_tracks_npz(tracks, tmp_path / "a.tracks.npz")
    assert main(["view", str(log), str(tmp_path / "a.tracks.npz"), "--once", "--port", "0"]) == 0
    assert "Open http://localhost:" in capsys.readouterr().out
    assert main(["view"]) == 2
    assert main(["view", str(tmp_path / "none.mcap"), "--once"]) == 1
    assert main(["view", str(log), str(log), "--once"]) == 1
    assert "none.mcap" in capsys.readouterr().err


def test_a_recording_without_frames_is_refused():
    _, _, recording = simulated("arm")
    with pytest.raises(ValueError, match="nothing to show"):
        Viewer(replace(recording, frames=()), port=0)
