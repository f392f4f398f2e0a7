"""Somebody on a treadmill or a stage has its top for a floor; behind a table, on a sofa, between boxes nobody has."""

from dataclasses import replace
from importlib.resources import files
from itertools import islice

import numpy as np
import pytest

import voodoo_jax as vj
from tests.support.rooms import FLOOR, box, build_of, figure, frame, grid, room
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.raise_floor import on_its_floor
from voodoo_jax.detect.scene import find_scene
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.scene import Scene

BODY, UP = build_of(), np.array([0, 0, 1], np.float32)
ROOM = Scene(FLOOR, (Plane(np.array([-1, 0, 0], np.float32), -4.5),), True)


def level(x: float, y: float, deep: float, wide: float, height: float) -> np.ndarray:
    """Top and front of a low thing."""
    a = grid((x - deep / 2, x + deep / 2), (y - wide / 2, y + wide / 2), 0.03)
    top = np.column_stack([a, np.full(len(a), height)])
    return np.concatenate([top, box(x - deep / 2, y, wide, height)])


def raised_by(rng, *things: np.ndarray, count: int = 3) -> float:
    clouds = [np.concatenate([room(rng), *things]) for _ in range(count)]
    clouds = [cloud + rng.normal(0, 0.005, cloud.shape) for cloud in clouds]
    return on_its_floor([frame(c, i) for i, c in enumerate(clouds)], ROOM, BODY, DetectSettings()).floor.offset


def standing(x: float, y: float, on: float) -> np.ndarray:
    return figure(x, y) + [0, 0, on]


@pytest.mark.parametrize("height", [0.12, 0.3, 0.42])
@pytest.mark.parametrize("size", [(1.6, 0.8), (1.0, 2.5)])
def test_a_treadmill_or_stage_is_the_floor_of_who_stands_on_it(rng, height, size):
    on_it = level(2.8, 0.2, *size, height), standing(2.8, 0.2, height)
    assert raised_by(rng, *on_it) == pytest.approx(height, abs=0.01)


def test_what_nobody_stands_on_is_no_floor(rng):
    table = level(2.2, 0.0, 0.8, 1.4, 0.4)
    behind = figure(3.0, 0.0)
    behind = behind[behind[:, 2] > 0.35]  # what the table does not hide
    sofa = level(2.9, 0.0, 0.8, 1.8, 0.42)
    trunk, legs = figure(3.0, 0.0, 0.9) + [0, 0, 0.42], box(2.5, 0.0, 0.4, 0.55)
    knees = np.column_stack([grid((2.5, 2.85), (-0.2, 0.2)), np.full(360, 0.55)])
    sides = level(2.8, -0.8, 0.8, 0.6, 0.3), level(2.8, 0.8, 0.8, 0.6, 0.3)
    for things in (
        (table, behind),
        (sofa, trunk, legs, knees),
        (*sides, figure(2.8, 0.0)),
        (table,),
        (figure(2.8, 0),),
    ):
        assert raised_by(rng, *things) == 0
    assert on_its_floor([], ROOM, BODY, DetectSettings()) is ROOM


def test_who_only_begins_on_a_step_has_the_rooms_floor(rng):
    step = level(2.8, 0.0, 1.0, 1.0, 0.2)
    clouds = [np.concatenate([room(rng), step, standing(2.8, 0.0, 0.2)])] * 2
    clouds.append(np.concatenate([room(rng), step, figure(2.8, 1.1)]))
    frames = [frame(cloud, i) for i, cloud in enumerate(clouds)]
    assert on_its_floor(frames, ROOM, BODY, DetectSettings()) is ROOM


def test_a_larger_stage_than_floor(rng):
    """Then no floor is found, for too much is below the stage, and z = 0 stands for it."""
    stage, floor = level(2.8, 0.0, 1.8, 2.6, 0.3), room(rng)[::3]
    clouds = [np.concatenate([floor, stage, standing(2.8, 0.0, 0.3)])] * 3
    frames = [frame(cloud, i) for i, cloud in enumerate(clouds)]
    scene = on_its_floor(frames, find_scene(frames, UP), BODY, DetectSettings())
    assert scene.floor_seen and scene.floor.offset == pytest.approx(0.3, abs=0.01)


def test_the_size_of_who_stands_on_something_is_theirs():
    """The demo on a stage that nobody has told of: 30 cm higher, and the room's floor around."""
    source = open_log(str(files("voodoo_jax") / "data" / "demo.mcap"))
    frames = list(islice(source.frames(), 24))
    middle = np.median(np.concatenate([f.points[f.points[:, 2] > 0.1] for f in frames[:3]]), 0)
    near, far = middle[0] - 0.7, middle[0] + 0.7

    def on_stage(f):
        points = f.points.copy()
        floor = points[:, 2] < 0.04
        points[~floor, 2] += 0.3
        ahead = (points[:, 0] > near) & (points[:, 0] < far) & (np.abs(points[:, 1] - middle[1]) < 0.9)
        points[floor & ahead, 2] += 0.3
        return replace(f, points=points, origins=f.origins + np.float32([0, 0, 0.3]), rays=type(f.rays)())

    recorded = Recording("demo", source.fixed_frame, source.up, source.sensors, tuple(map(on_stage, frames)))
    tracks = vj.track(vj.load_body("human"), recorded)
    plain = replace(recorded, frames=tuple(replace(f, rays=type(f.rays)()) for f in frames))
    wanted = vj.track(vj.load_body("human"), plain)
    assert abs(float(tracks.body.scale) - float(wanted.body.scale)) < 0.02
    assert np.linalg.norm(tracks.joints - wanted.joints - [0, 0, 0.3], axis=-1).mean() < 0.02
