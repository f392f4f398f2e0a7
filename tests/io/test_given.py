"""What a log lacks can be given: calibrations and transforms. Depth that is lost is said to be."""

import numpy as np
import pytest

from tests.support.logs import START, K, Log, T, depth_log, depth_metres, header, ros_image, ros_tf
from voodoo_jax.config.options import ReadSettings, SettingsError
from voodoo_jax.io.log_reader import LogError, read_log

ROWS = "[100, 0, 15.5, 0, 110, 11.5, 0, 0, 1]"
FILES = {
    # as `ros2 topic echo --once` prints it
    "echo.yaml": f"header:\n  frame_id: other\nheight: 24\nwidth: 32\n"
    f"distortion_model: plumb_bob\nd: []\nk: {ROWS}\n---\n",
    # as camera_calibration writes it
    "ost.yaml": "image_width: 32\nimage_height: 24\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: " + ROWS
    + "\ndistortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n",
    "own.toml": "fx = 100\nfy = 110\ncx = 15.5\ncy = 11.5\n",
    "info.json": '{"width": 32, "height": 24, "K": ' + ROWS + "}",
}  # fmt: skip
PLACED = "base cam_optical 0 0 1.25 -0.5 0.5 -0.5 0.5"


def bare_log(tmp_path):
    """Depth alone: neither calibration nor transform."""
    return Log().add("/cam/depth", START, ros_image(START, "cam_optical", depth_metres())).write(tmp_path / "a.mcap")


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("topic", ["", "/cam/depth="])
def test_a_forgotten_calibration_and_transform(tmp_path, name, topic):
    (tmp_path / name).write_text(FILES[name])
    settings = ReadSettings(camera=(f"{topic}{tmp_path / name}",), transform=(PLACED,))
    found = read_log(bare_log(tmp_path), settings)
    expected = read_log(depth_log(1).write(tmp_path / "b.mcap"))
    np.testing.assert_array_equal(found.frames[0].points, expected.frames[0].points)
    assert found.fixed_frame == "base" and found.notes == ()


def test_a_topics_own_file_wins_and_one_for_all_does_not(tmp_path):
    (tmp_path / "wide.toml").write_text("fx = 50\nfy = 55\ncx = 15.5\ncy = 11.5\n")
    log = depth_log(1).write(tmp_path / "b.mcap")
    plain = read_log(log).frames[0].points
    with_all = read_log(log, ReadSettings(camera=(str(tmp_path / "wide.toml"),))).frames[0].points
    np.testing.assert_array_equal(with_all, plain)
    own = read_log(log, ReadSettings(camera=(f"/cam/depth={tmp_path / 'wide.toml'}",))).frames[0].points
    np.testing.assert_allclose(own[:, 1], 2 * plain[:, 1], atol=1e-5)


@pytest.mark.parametrize("parent", ["base", "mast"])
@pytest.mark.parametrize("static", [True, False])
def test_a_transform_that_is_given_wins(tmp_path, parent, static):
    """Over the log's own, from the same parent or from another one."""
    log = depth_log(1)
    for k in (0, 1):
        turned = ros_tf((START + k, parent, "cam_optical", (0.0, 0.0, 2.0 + k), (0.0, 0.0, 0.0, 1.0)))
        log.add("/tf_static" if static else "/tf", START + k, turned)
    settings = ReadSettings(transform=(PLACED,), fixed_frame="base")
    found = read_log(log.write(tmp_path / "a.mcap"), settings)
    expected = read_log(depth_log(1).write(tmp_path / "b.mcap"))
    np.testing.assert_array_equal(found.frames[0].points, expected.frames[0].points)
    assert len([note for note in found.notes if "read.transform" in note]) == 1


def test_what_is_given_wrongly_is_said(tmp_path):
    log = bare_log(tmp_path)
    with pytest.raises(LogError, match="read.camera"):
        read_log(log)
    (tmp_path / "a.yaml").write_text("k: [0, 0, 0, 0, 0, 0, 0, 0, 0]")
    (tmp_path / "b.yaml").write_text("k: [1, 2]")
    (tmp_path / "c.yaml").write_text("a: [")
    for name in ("a.yaml", "b.yaml", "c.yaml", "none.yaml"):
        with pytest.raises(SettingsError, match="read.camera"):
            read_log(log, ReadSettings(camera=(str(tmp_path / name),)))
    for word in ("base cam 0 0 1", "base cam 0 0 1 0 0 0 0", "base cam a b c 0 0 0 1"):
        with pytest.raises(SettingsError, match="read.transform"):
            read_log(log, ReadSettings(transform=(word,)))


def test_depth_as_jpeg_is_lost(tmp_path):
    image = T["sensor_msgs/msg/CompressedImage"]
    lost = image(header(START, "cam"), "16UC1; jpeg compressed ", np.frombuffer(b"\xff\xd8\xff\xe0abc", np.uint8))
    log = Log().add("/cam/depth/compressed", START, lost)
    with pytest.raises(LogError, match="JPEG.*'/cam/depth/compressedDepth'") as told:
        read_log(log.write(tmp_path / "a.mcap"))
    assert len(str(told.value)) < 400
    assert K[0, 0] == 100  # what the files say
