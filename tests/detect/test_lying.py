"""Who lies is found by how low and long they are, if they move, and do not slide; beds and dogs are not."""

import numpy as np
import pytest

from tests.support.rooms import FLOOR, ORIGIN, box, build_of, figure, frame, grid, room
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import extent, find_lying, mostly_lie
from voodoo_jax.detect.raise_floor import with_beds
from voodoo_jax.detect.tracklets import Tracklets
from voodoo_jax.records.observation import whole
from voodoo_jax.records.scene import Scene

SCENE, TALL = Scene(FLOOR, (), True), 1.75
AREA = 0.02**2


def lying(long: float = 1.6, wide: float = 0.4, high: float = 0.25, on: float = 0.0, x: float = 3.0) -> np.ndarray:
    """The top of a rounded thing along y, a metre and more before the sensor."""
    a = grid((-wide / 2, wide / 2), (-long / 2, long / 2))
    return np.column_stack([x + a[:, 0], a[:, 1], on + high * (1 - (a[:, 0] / wide) ** 2)])


def arm(angle: float, on: float = 0.0) -> np.ndarray:
    """Of who lies so: a forearm that is raised, and swings."""
    along = np.repeat(np.arange(0, 0.35, 0.01), 12)
    around = np.tile(np.linspace(0, np.pi, 12), len(along) // 12)
    out = np.column_stack([0.04 * np.cos(around), along * np.sin(angle), along * np.cos(angle) + 0.04 * np.sin(around)])
    return out + [2.95, 0.2, on + 0.25]


def found(clouds, rng) -> tuple[list[int], Tracklets]:
    """How many points are taken of each frame."""
    tracklets = Tracklets(SCENE, build_of(TALL), DetectSettings(), True)
    noisy = (cloud + rng.normal(0, 0.004, cloud.shape) for cloud in clouds)
    return [len(f.points) for f in tracklets(frame(c, i) for i, c in enumerate(noisy))], tracklets


def test_how_things_lie():
    seen = extent(lying().astype(np.float32), FLOOR)
    assert abs(seen.axis[1]) > 0.99 and seen.lies
    np.testing.assert_allclose(seen.middle[:2], [3.0, 0.0], atol=0.02)
    assert seen.length == pytest.approx(1.57, abs=0.03) and seen.height < 0.25
    assert not extent(figure(3.0, 0.0).astype(np.float32), FLOOR).lies
    assert mostly_lie([whole(frame(lying()))] * 3, FLOOR) and not mostly_lie(
        [whole(frame(figure(3.0, 0.0)))] * 3, FLOOR
    )
    assert not mostly_lie([], FLOOR)


@pytest.mark.parametrize(
    "thing, person",
    [
        (lying(), True),
        (lying(1.0, 0.3), True),  # a child, or with knees drawn up
        (lying(0.7, 0.25), False),  # a dog
        (lying(3.0, 0.4), False),  # a carpet
        (lying(2.0, 1.5), False),  # a mattress
        (lying(1.6, 0.04, 0.04), False),  # a pole
        (figure(3.0, 0.0), False),
    ],
)
def test_what_is_as_large_as_a_body(thing, person):
    points = thing.astype(np.float32)
    label, area = np.zeros(len(points), int), np.full(len(points), AREA)
    assert (find_lying(points, label, area, FLOOR, TALL) == 0) is person


@pytest.mark.parametrize("on", [0.0, 0.5])
def test_who_lies_on_the_floor_or_a_bed_and_moves_an_arm_is_found(rng, on):
    top = grid((2.5, 3.5), (-1.1, 1.1), 0.03)
    bed = np.concatenate([np.column_stack([top, np.full(len(top), on)]), box(2.5, 0.0, 2.2, on)])
    still = [room(rng), lying(on=on), *([bed] if on else [])]
    count, tracklets = found([np.concatenate([*still, arm(np.sin(i / 5), on)]) for i in range(40)], rng)
    assert min(count) > 0.8 * len(lying())
    assert tracklets.finder.scene.floor.offset == pytest.approx(on, abs=0.02)
    assert not any(found([np.concatenate(still)] * 40, rng)[0])


def test_what_slides_over_the_floor_is_nobody(rng):
    clouds = [np.concatenate([room(rng), lying() + [0, 0.04 * i - 0.8, 0]]) for i in range(40)]
    assert not any(found(clouds, rng)[0])


def test_who_stands_is_followed_though_something_lies_and_moves(rng):
    clouds = [
        np.concatenate([lying(x=2.2), arm(np.sin(i / 5)) - [0.75, 0, 0], figure(3.4, 0.5 + 0.02 * i)])
        for i in range(40)
    ]
    tracklets = Tracklets(SCENE, build_of(TALL), DetectSettings(), True)
    assert all(FLOOR.top(f.points) > 1.5 for f in tracklets(frame(c, i) for i, c in enumerate(clouds)))


def test_each_top_may_be_a_bed_and_the_back_of_a_sofa_is_a_wall(rng):
    seat = grid((2.6, 3.2), (-1.0, 1.0), 0.03)
    sofa = [np.column_stack([seat, np.full(len(seat), 0.42)]), box(2.6, 0.0, 2.0, 0.42), box(3.2, 0.0, 2.0, 0.85)]
    cloud = np.concatenate([room(rng), *sofa])
    backed, bare, last = with_beds(frame(cloud + rng.normal(0, 0.004, cloud.shape)), SCENE, 0.8)
    assert last is SCENE and bare.walls == () and bare.floor.offset == pytest.approx(0.42, abs=0.02)
    (back,) = backed.walls
    assert back.height(ORIGIN)[0] > 0 and abs(back.offset + 3.2) < 0.03
