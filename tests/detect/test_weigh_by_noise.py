"""Noise of a sensor, told from the points themselves, and what noisy points weigh."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.segments import blank_tracks
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.weigh_by_noise import FEWEST, range_noise, weighed
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.markers.own_sites import named_subject
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.diagnostics import notes_on
from voodoo_jax.trackers.icp.runner import Runner

ORIGIN = np.array([0.3, -0.2, 1.2], np.float32)


def cylinder(rng, distance: float, sigma: float, step: float = 0.005, radius: float = 0.15) -> np.ndarray:
    """An upright cylinder as a depth camera sees it: a ray every `step` radians, noise along the rays."""
    across, down = np.meshgrid(np.arange(-0.3, 0.3, step), np.arange(-0.5, 0.5, step))
    rays = np.stack([np.ones(across.size), across.ravel(), down.ravel()], -1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    a, b = np.sum(rays[:, :2] ** 2, 1), -2 * rays[:, 0] * distance  # (x - distance)^2 + y^2 = radius^2
    root = b**2 - 4 * a * (distance**2 - radius**2)
    hit = root > 0
    along = (-b[hit] - np.sqrt(root[hit])) / (2 * a[hit])
    return (ORIGIN + rays[hit] * (along + rng.normal(0, sigma, hit.sum()))[:, None]).astype(np.float32)


def frame(points, sensors: int = 1, **more) -> BodyObservation:
    sensor = np.zeros(len(points), np.int32)
    return BodyObservation(10**18, points, sensor, np.stack([ORIGIN] * sensors), **more)


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("distance", [1.5, 3.0, 5.0])
def test_noise_is_what_was_added(rng, distance, sigma):
    found = range_noise(cylinder(rng, distance, sigma), ORIGIN)
    # a bent surface between neighbours that are 2 cm apart looks like noise of some millimetres
    assert sigma * 0.85 < found < sigma * 1.2 + 0.003


def test_noise_of_a_slanted_surface(rng):
    """What is seen at a grazing angle is not noise: half a metre of depth, 5 mm of noise."""
    points = cylinder(rng, 3.0, 0.005)
    points[:, 0] += points[:, 2] * 0.5
    assert range_noise(points, ORIGIN) < 0.01


@pytest.mark.parametrize("sigma", [0.005, 0.01])
def test_noise_of_clouds_that_were_joined(rng, sigma):
    """Points of the far side lie beside those of the near side in the picture; on the surface they do not."""
    near = cylinder(rng, 3.0, sigma)
    axis = np.float32([3.0 + ORIGIN[0], ORIGIN[1], ORIGIN[2]])
    far = (near - axis) * np.float32([-1, -1, 1]) + axis  # as from the other side
    both = rng.permutation(np.concatenate([near, far]))
    assert range_noise(both, ORIGIN) > 0.05  # the cylinder's thickness
    assert 0.6 * sigma < range_noise(both, ORIGIN, joined=True) < sigma * 1.2 + 0.003
    (seen,) = weighed([frame(both)], 0.01)
    assert seen.noise < sigma * 1.2 + 0.003


def test_few_points_tell_nothing(rng):
    points = cylinder(rng, 3.0, 0.01)
    assert np.isnan(range_noise(points[: FEWEST - 1], ORIGIN))
    assert np.isnan(range_noise(points[:0], ORIGIN))


@pytest.mark.parametrize(
    "points", [np.zeros((100, 3)), np.linspace([2, 0, 1], [2, 1, 1], 100)], ids=["one place", "a line"]
)
def test_degenerate_clouds(points):
    assert np.isfinite(range_noise(points.astype(np.float32), ORIGIN))


def test_noisy_points_weigh_less(rng):
    """In inverse proportion to the variance; from a sensor without much noise all weigh 1, that is: no weights."""
    quiet, loud = frame(cylinder(rng, 3.0, 0.01)), frame(cylinder(rng, 3.0, 0.06))
    first, second = next(weighed([quiet], 0.02)), next(weighed([loud], 0.02))
    assert first.weight is None and first.noise == pytest.approx(0.01, rel=0.2)
    assert second.noise == pytest.approx(0.06, rel=0.15)
    np.testing.assert_allclose(second.weight, 1 / 9, rtol=0.3)
    assert next(weighed([loud], 0.0)).weight is None


def test_weights_of_a_log_stay(rng):
    points = cylinder(rng, 3.0, 0.06)
    given = np.linspace(0.5, 2.0, len(points)).astype(np.float32)
    own = next(weighed([frame(points)], 0.02)).weight
    both = next(weighed([frame(points, weight=given)], 0.02)).weight
    np.testing.assert_allclose(both, own * given, rtol=1e-6)


def test_each_sensor_has_its_own_noise(rng):
    clouds = [cylinder(rng, 3.0, 0.01), cylinder(rng, 3.0, 0.08)]
    both = frame(np.concatenate(clouds), sensors=2)
    both = replace(both, sensor=np.repeat([0, 1], [len(c) for c in clouds]).astype(np.int32))
    weight = next(weighed([both], 0.02)).weight
    assert (weight[both.sensor == 0] == 1).all() and (weight[both.sensor == 1] < 0.12).all()


def test_noise_grows_on_the_way(rng):
    """A few points are weighed by what was measured before, at their own distance; an empty frame is passed on."""
    near, far = cylinder(rng, 2.0, 0.02), cylinder(rng, 4.0, 0.08)[: FEWEST - 1]
    frames = list(weighed([frame(near), frame(near[:0]), frame(far)], 0.02))
    assert [len(f.points) for f in frames] == [len(near), 0, FEWEST - 1] and frames[1].noise == 0
    assert frames[2].noise == pytest.approx(0.08, rel=0.25)


@pytest.mark.parametrize("sigma, said", [(0.02, False), (0.09, True)])
def test_a_noisy_log_says_so(rng, sigma, said):
    body, settings = human(), Settings()
    people = list(weighed([frame(cylinder(rng, 3.0, sigma))] * 3, settings.detect.noise))
    scene = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), True)
    run = Runner(body, options_from(settings.solve, settings.track), people, scene, settings)
    named = named_subject(people, body.topology, settings.features)
    notes = notes_on(run, blank_tracks(body, len(people)), named)
    assert any("Distances are noisy" in note for note in notes) == said
