"""Pieces above and below something nearer: one thing where all between them is hidden and they go on at one depth."""

import numpy as np
import pytest

from tests.support.rooms import FLOOR, ORIGIN, box, build_of, figure, frame, grid
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.cut_in_two import joined_labels
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.geometry.voxels import components
from voodoo_jax.records.observation import whole
from voodoo_jax.records.scene import Scene

BOARD = (2.0, 0.7, 1.05)  # metres: how far before the sensor, its lower and its upper edge
HEIGHT, GAP = 1.75, 0.008  # of the body, metres; between neighbouring points, radians


def board() -> np.ndarray:
    near, low, high = BOARD
    a = grid((-1.5, 1.5), (low, high))
    return np.stack([np.full(len(a), near), a[:, 0], a[:, 1]], -1)


def behind(points, near: float = BOARD[0]) -> np.ndarray:
    """Those of the points that the board does not hide."""
    along = near / points[:, 0]
    crossing = ORIGIN[0, 2] + along * (points[:, 2] - ORIGIN[0, 2])
    return points[(crossing < BOARD[1]) | (crossing > BOARD[2])]


def things(points, hides) -> int:
    """How many things some points are when others are seen, too."""
    seen, all_of_it = whole(frame(points)), whole(frame(np.concatenate([points, hides])))
    label = components(seen.points, 0.12)
    assert len(np.unique(label)) == 2
    return len(np.unique(joined_labels(seen, label, all_of_it, FLOOR, HEIGHT, GAP)))


def test_who_stands_behind_a_board_is_one():
    assert things(behind(figure(2.6, 0.0)), board()) == 1


def test_where_the_gap_is_seen_through_they_are_two():
    wall = box(4.0, 0.0, 3.0, 2.0)
    assert things(behind(figure(2.6, 0.0)), wall) == 2


def test_where_nothing_is_seen_in_the_gap_they_are_two():
    assert things(behind(figure(2.6, 0.0)), np.zeros((0, 3))) == 2


@pytest.mark.parametrize("x, y", [(3.2, 0.0), (2.6, 0.6)])
def test_what_is_below_at_another_depth_or_aside_is_something_else(x, y):
    person, other = behind(figure(2.6, 0.0)), behind(figure(x, y))
    assert things(np.concatenate([person[person[:, 2] > 0.9], other[other[:, 2] < 0.9]]), board()) == 2


def test_furniture_that_is_wider_than_a_body_is_something_else():
    person, sofa = behind(figure(2.6, 0.0)), behind(box(2.5, 0.0, 1.6, 0.7))
    assert things(np.concatenate([person[person[:, 2] > 0.9], sofa]), board()) == 2


def test_they_are_found_together():
    """All of who stands behind a board is the body's, from the first frame in which they are seen."""
    person = behind(figure(2.6, 0.0))
    for hides, lowest in ((board(), 0.05), (box(4.0, 0.0, 3.0, 2.0), 1.03)):
        finder = BodySegmenter(Scene(FLOOR, (), True), build_of(HEIGHT), DetectSettings())
        seen = finder(frame(np.concatenate([person, hides])))
        mine = seen.points[seen.points[:, 0] < 2.65]
        assert len(mine) > 500 and mine[:, 2].max() > 1.6 and abs(mine[:, 2].min() - lowest) < 0.05
        assert len(mine) == len(seen.points)


@pytest.mark.parametrize("gap, one", [(0.105, True), (0.2, False)])
def test_a_head_belongs_to_the_shoulders_that_it_is_near(gap, one):
    """A neck is thin: a cell of the grid may be empty where the gap is shorter than `link`."""
    trunk = figure(2.5, 0.0, 1.41)
    head = figure(2.41, 0.0, 0.22, 0.09) + [0, 0, 1.4 + gap]
    cloud = np.concatenate([trunk, head])
    assert len(np.unique(components(cloud.astype(np.float32), 0.12))) == 2
    seen = BodySegmenter(Scene(FLOOR, (), True), build_of(HEIGHT), DetectSettings())(frame(cloud))
    assert (seen.points[:, 2].max() > 1.5) == one
