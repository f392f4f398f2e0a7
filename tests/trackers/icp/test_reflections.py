"""Who is the image of another person in a plane is nobody; who does the same, or stands behind a plane, is somebody."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.truth import truth_tracks
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import whole
from voodoo_jax.records.scene import Scene, Subject
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.icp.people import main_first
from voodoo_jax.trackers.icp.reflections import reflected

BODY, TIME = scaled(human(), 1.75), np.arange(24) / 12.0
SCENE = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)
WALL, APART, ASIDE = (
    3.0,
    0.8,
    0.3,
)  # metres: of the wall from the camera, of the person from it, and from the middle of the picture
SWING = np.outer(np.radians(50 - 50 * np.cos(3 * TIME)), [0.0, -1.0, 0.0]).astype(np.float32)  # forwards


def swung(side: str, late: int = 0, much: float = 1.0) -> dict[str, np.ndarray]:
    """This arm swings forwards, and the other one half as much."""
    other = "r" if side == "l" else "l"
    return {f"{s}_shoulder": share * much * np.roll(SWING, late, 0) for s, share in ((side, 1.0), (other, 0.5))}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Somebody before a wall, their image in it, and others in its place: as tracks and as points."""

    def person(name, moves, x, yaw):
        one = simulate(BODY, placed(motion_of_turns(BODY, TIME, moves), x, ASIDE, yaw), tof_camera(1.2, 0.0), room=None)
        path = write_simulation(one, tmp_path_factory.mktemp("mirror") / f"{name}.mcap")
        return truth_tracks(one), Subject(1, SCENE, [whole(frame) for frame in read_log(path).frames])

    behind = WALL + APART, np.pi
    return {
        "person": person("person", swung("l"), WALL - APART, 0.0),
        "image": person("image", swung("r"), *behind),
        "same arm": person("same", swung("l"), *behind),
        "later": person("later", swung("r", 6), *behind),
        "still": person("still", swung("r", 0, 0.02), *behind),
        "person, still": person("person_still", swung("l", 0, 0.02), WALL - APART, 0.0),
    }


def images(seen, *names):
    tracks, subjects = zip(*(seen[name] for name in names))
    return reflected(list(subjects), list(tracks))


@pytest.mark.parametrize("order", [("person", "image"), ("image", "person")])
def test_who_is_behind_the_plane_is_the_image(seen, order):
    found = images(seen, *order)
    ((image, (person, away)),) = found.items()
    assert (order[image], order[person]) == ("image", "person")
    assert away == pytest.approx(APART, abs=0.1)


@pytest.mark.parametrize("other", ["same arm", "later", "still"])
def test_who_does_something_else_there_is_somebody(seen, other):
    assert not images(seen, "person", other)


def test_of_two_who_stand_still_nothing_tells(seen):
    assert not images(seen, "person, still", "still")


def test_an_image_gets_no_number(seen):
    tracks = [replace(seen[name][0], person=k) for k, name in enumerate(("person", "image"))]
    assert main_first(tracks) == [1]
