"""Two publishers who contradict each other about a frame: told, asked, and one of them taken."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.io.test_which_depth import BODY, DOWN, HEIGHT, SIZE, K, room
from tests.support.logs import START, Log, ros_calibration, ros_image, ros_tf
from voodoo_jax.io.log_reader import open_log, read_log
from voodoo_jax.io.transforms import Transform, TransformTree, to_and_fro


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
    assert found.sure == 1.0 and any("jumps between 2 poses, 12 times" in note for note in found.notes)
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


@pytest.mark.parametrize("pattern", [[0, 1, 1, 1, 1, 1], [0, 1, 2], [0, 0, 1, 0, 1, 1, 1]])
def test_publishers_have_other_rates_or_are_three(pattern):
    which = np.array(pattern * 12)
    drift = 0.002 * np.arange(len(which))  # and all of them move
    places = np.column_stack([0.15 * which + drift, -0.1 * (which == 2), 0 * drift])
    found = to_and_fro(places, np.tile([0.0, 0, 0, 1], (len(which), 1)))
    assert found is not None and np.array_equal(found, which)


LEVEL = Rotation.from_matrix(DOWN @ BODY)
OTHER = Rotation.from_euler("x", 6, degrees=True) * LEVEL
ASIDE = Rotation.from_euler("z", 6, degrees=True) * LEVEL


def stated(path, *transforms):
    """Images of a room, and transforms (topic, parent, rotation) of the camera, given once, or with each image."""
    out = Log().add("/camera/camera_info", START, ros_calibration("optical", K, size=SIZE))
    for i in range(12):
        stamp = START + i * 5 * 10**7
        for topic, parent, turn in transforms if i == 0 else [one for one in transforms if one[0] == "/tf"]:
            q = tuple(turn.as_quat().tolist())
            out.add(topic, stamp, ros_tf((stamp, parent, "optical", (0.0, 0.0, HEIGHT), q)))
        out.add("/camera/image", stamp, ros_image(stamp, "optical", room(i)))
    return out.write(path)


@pytest.mark.parametrize("right_first", [True, False])
@pytest.mark.parametrize("topics", [("/tf_static", "/tf_static"), ("/tf_static", "/tf")])
def test_static_transforms_are_contradicted(topics, right_first, tmp_path):
    turns = (LEVEL, OTHER) if right_first else (OTHER, LEVEL)
    found = open_log(stated(tmp_path / "a.mcap", *((t, "room", turn) for t, turn in zip(topics, turns))))
    assert found.sure == 1.0 and any("the floor is level with the one that is used" in note for note in found.notes)
    points = next(found.frames()).points
    assert abs(float(np.median(points[points[:, 2] < 0.2, 2]))) < 0.01
    asked = open_log(stated(tmp_path / "b.mcap", (topics[0], "room", LEVEL), (topics[1], "room", ASIDE)))
    assert asked.sure == 0.5 and any(note.count('"room optical') == 2 for note in asked.notes)


def test_of_two_parents_the_one_with_a_level_floor_is_taken(tmp_path):
    """Whichever is given first; the walls of the room need not lie along the axes of its frame."""
    turned = Rotation.from_euler("z", 34, degrees=True) * LEVEL
    both = ("/tf_static", "driver", Rotation.identity()), ("/tf_static", "room", turned)
    for name, ways in (("a", both), ("b", both[::-1])):
        found = open_log(stated(tmp_path / f"{name}.mcap", *ways))
        assert found.fixed_frame == "room" and found.sure == 1.0
        assert any("has 2 parents, " in note and "'room' is used" in note for note in found.notes)


def test_a_static_transform_that_is_given_again_or_elsewhere_is_no_contradiction(tmp_path):
    found = open_log(stated(tmp_path / "a.mcap", *[("/tf_static", "room", LEVEL)] * 2, ("/tf", "room", LEVEL)))
    assert found.sure == 1.0 and not any("disagree" in note for note in found.notes)


def test_a_static_transform_that_is_repeated_has_not_changed():
    """Whatever its rotation: angles by arc cosines are some 1e-8 off for some of them."""
    tree = TransformTree()
    for k, q in enumerate(Rotation.random(2000, rng=np.random.default_rng(0)).as_quat()):
        for stamp in (START, START + 10**9):
            tree.add(Transform(stamp, "room", f"frame{k}", np.array([1.0, 2.0, 0.5]), q), True)
    tree.close()
    assert not tree.notes and not tree.torn
