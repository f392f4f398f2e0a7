"""Two publishers who contradict each other about a frame: told, asked, and one of them taken."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.io.test_which_depth import BODY, DOWN, HEIGHT, SIZE, K, room
from tests.support.logs import START, Log, ros_calibration, ros_image, ros_tf
from voodoo_jax.io.log_reader import open_log, read_log
from voodoo_jax.io.transforms import to_and_fro


def log(path, other, count=12):
    """Images of a room, and transforms that give the camera's place in turns rightly and turned by `other`."""
    out = Log().add("/camera/camera_info", START, ros_calibration("optical", K, size=SIZE))
    for i in range(count):
        turn = (other if i % 2 else Rotation.identity()) * Rotation.from_matrix(DOWN @ BODY)
        q = tuple(turn.as_quat().tolist())
        stamp = START + i * 5 * 10**7
        out.add("/tf", stamp, ros_tf((stamp, "room", "optical", (0.0, 0.0, HEIGHT), q)))
        out.add("/camera/image", stamp, ros_image(stamp, "optical", room(i)))
    return out.write(path)


def test_the_one_with_which_the_floor_is_level_is_taken(tmp_path):
    found = open_log(log(tmp_path / "a.mcap", Rotation.from_euler("y", 6, degrees=True)))
    assert found.sure == 1.0 and any("jumps between two poses, 12 times" in note for note in found.notes)
    points = next(found.frames()).points
    low = points[points[:, 2] < 0.2]
    assert len(low) > 500 and abs(float(np.median(low[:, 2]))) < 0.01


def test_where_nothing_tells_it_is_asked_and_doubted(tmp_path):
    found = read_log(log(tmp_path / "a.mcap", Rotation.from_euler("z", 6, degrees=True)))
    assert found.sure == 0.5 and any(note.count('"room optical') == 2 for note in found.notes)


@pytest.mark.parametrize("speed", [0.05, 0.6])
def test_a_camera_that_pans_does_not_jump(speed):
    """Slowly, or by 30 degrees to and fro in two seconds."""
    angle = 30 * np.sin(2 * np.pi * speed * np.arange(60) / 10)
    q = Rotation.from_euler("z", angle[:, None], degrees=True).as_quat()
    noise = np.random.default_rng(0).normal(0, 0.002, (60, 3))
    assert to_and_fro(noise, q) is None
