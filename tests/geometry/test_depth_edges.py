"""Depth edges that a camera's filters have smeared: told from sharp ones, and what lies in them is found."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.detect.opening import open_checked
from voodoo_jax.geometry.depth_edges import REACH, SMEARED, between_edges, on_sheets
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import NO_NOISE, tof_camera

ANGLE = 1 / 600  # radians between the pixels of the images made by hand


def disc(near: float = 2.0, far: float = 2.6) -> np.ndarray:
    """A disc before a wall, metres."""
    v, u = np.mgrid[:240, :320]
    return np.where(np.hypot(v - 120, u - 160) < 60, near, far).astype(np.float32)


def smeared(depth: np.ndarray, sigma: float = 3.0) -> np.ndarray:
    """As a camera that filters disparities."""
    return 1 / cv2.GaussianBlur((1 / depth).astype(np.float32), (0, 0), sigma)


def test_smeared_edges_are_told_from_sharp_ones():
    flying = disc()
    flying[60:180, 99::121] = 2.3  # one pixel of both depths
    assert between_edges(disc()) == 0 and between_edges(flying) < 0.2 < SMEARED < between_edges(smeared(disc()))
    noise = np.random.default_rng(0).uniform(1.0, 4.0, (240, 320)).astype(np.float32)
    assert between_edges(noise) == 0
    assert between_edges(np.zeros((240, 320), np.float32)) == between_edges(np.full((20, 8), 2.0, np.float32)) == 0


@pytest.mark.parametrize("every", [1, 2, 4])
def test_the_sheet_between_two_things_is_found_and_the_things_are_kept(every):
    sharp, depth = disc()[::every, ::every], smeared(disc())[::every, ::every]
    off = np.minimum(np.abs(depth - 2.0), np.abs(depth - 2.6))
    found = on_sheets(depth, every * ANGLE, every)
    assert found[off > 0.1].mean() > 0.95 and found[off < 0.005].mean() < 0.02
    assert not on_sheets(np.zeros_like(sharp), every * ANGLE, every).any()


def test_a_floor_seen_as_obliquely_is_kept():
    """From a height of 0.4 m, where all that is farther than 2 m is seen at more than 78 degrees."""
    below = (np.arange(30, 480) * ANGLE)[:, None]  # tangents of the angle below the horizon
    floor = np.broadcast_to(0.4 / below, (450, 320)).astype(np.float32)
    steep = np.abs(np.gradient(floor, axis=0)) > 4.7 * ANGLE * floor
    inner = slice(REACH, -REACH)
    assert steep[inner].mean() > 0.05 and not on_sheets(floor, ANGLE, 1)[inner].any()


def test_a_log_of_such_a_camera_is_read_without_them(tmp_path):
    """Between a simulated person and the wall behind them, and said; of the same log with sharp edges nothing is."""
    camera = replace(tof_camera(), width=320, height=248, fx=363.7, fy=344.5, cx=159.5, cy=123.5)
    motion = placed(make_motion(vj.human(), "walk", 0.15), 2.4, 0.0, np.pi)
    sharp = simulate(vj.human(), motion, camera, NO_NOISE, Room(wall=3.1, boxes=()))
    blurred = np.stack([1000 * smeared(d / 1000) for d in sharp.depth]).astype(np.uint16)
    logs = {name: replace(sharp, depth=depth) for name, depth in (("sharp", sharp.depth), ("smeared", blurred))}
    paths = {name: write_simulation(log, tmp_path / f"{name}.mcap") for name, log in logs.items()}

    def between(reader) -> int:
        """Points of the first frame over the floor, behind the person and before the wall."""
        x, _, height = next(iter(reader.frames())).points.T
        return int(np.sum((height > 0.3) & (x > 2.8) & (x < 3.0)))

    left, none = open_checked(paths["smeared"]), open_checked(paths["sharp"])
    assert between(left) < 0.15 * between(open_log(paths["smeared"])) and between(none) == 0
    assert ["smeared" in note for note in left.notes].count(True) == 1
    assert not any("smeared" in note for note in none.notes)
