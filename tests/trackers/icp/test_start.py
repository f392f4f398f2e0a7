"""Size, place and heading at the beginning."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.helpers import frustum_mesh
from voodoo_jax.config.options import DetectSettings, Settings, StartSettings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import joint_centres, rest_box, rest_height, scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.front import track
from voodoo_jax.trackers.icp.body_size import measured_heights, sized
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.trials import facing, place, standing_places

UP = np.array([0, 0, 1], np.float32)
FLOOR = Plane(UP, 0.0)


def column(height: float, x: float, origin=(0.0, 0.0, 1.2), pixel: float = 0.006, count: int = 12) -> BodyObservation:
    """A plate of `height` seen by a camera: rows `pixel` radians apart, the topmost one anywhere below the edge."""
    rows = np.arange(0.05, height, pixel * max(abs(x), 1.0))
    points = np.stack(np.meshgrid([x], np.linspace(-0.1, 0.1, count), rows, indexing="ij"), -1).reshape(-1, 3)
    return BodyObservation(
        0, points.astype(np.float32), np.zeros(len(points), np.int32), np.array([origin], np.float32)
    )


@pytest.mark.parametrize("name", ["arm", "dog", "human10"])
@pytest.mark.parametrize("scale", [0.5, 1.0, 1.9])
def test_the_box_around_the_body_at_rest(name, scale):
    body = scaled(load_body(name), scale)
    surface = []
    for i, size in enumerate(np.asarray(body.sizes)):
        turn = Rotation.from_quat(np.asarray(body.rest.rotation[i]), scalar_first=True)
        surface.append(turn.apply(frustum_mesh(size).vertices) + np.asarray(body.rest.translation[i]))
    surface = np.concatenate(surface)
    np.testing.assert_allclose(rest_box(body), [surface.min(0), surface.max(0)], atol=1e-3)
    top = surface[:, 2].max()
    expected = scale if body.scale_name == "stature" else top
    assert rest_height(body) == pytest.approx(expected, abs=1e-3)
    assert top == pytest.approx(expected, rel=0.03)  # the stature is where the body's top is


@pytest.mark.parametrize("height", [1.0, 1.5, 1.83, 2.0])
@pytest.mark.parametrize("distance", [1.5, 4.0])
def test_measured_height(height, distance):
    """Within a pixel; frames without enough points say nothing."""
    frames = [column(height, distance, pixel=0.006)] * 3
    few = replace(frames[0], points=frames[0].points[:10], sensor=frames[0].sensor[:10])
    found = measured_heights([few, *frames], FLOOR, 0.006)
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1:], height, atol=0.006 * distance + 0.005)


def test_measured_height_forgives_strays():
    good = column(1.8, 3.0)
    stray = replace(
        good, points=good.points + np.where(np.arange(len(good.points)) < 2, 2, 0)[:, None].astype(np.float32) * UP
    )
    clean = measured_heights([good], FLOOR, 0.006)
    assert measured_heights([stray], FLOOR, 0.006) == pytest.approx(clean, abs=1e-5)  # two points too high
    worse = replace(good, points=good.points + np.float32(0.5) * UP)
    size = sized(human(), [good, worse, good], FLOOR, StartSettings()).scale  # one frame of three
    assert float(size) == pytest.approx(float(sized(human(), [good], FLOOR, StartSettings()).scale), abs=1e-5)


def test_a_raised_hand_is_not_the_head():
    body, hand = column(1.8, 3.0), column(2.2, 3.0, count=3)
    aside = hand.points[hand.points[:, 2] > 1.6] + np.array([0, 0.35, 0], np.float32)
    points = np.concatenate([body.points, aside])
    both = replace(body, points=points, sensor=np.zeros(len(points), np.int32))
    assert measured_heights([both], FLOOR, 0.006) == pytest.approx(2.2, abs=0.03)
    assert measured_heights([both], FLOOR, 0.006, reach=0.2) == pytest.approx(1.8, abs=0.03)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, 2.5), (0, 1, 0), (0.6, 0, 0.8), (0.1, -0.9, 0.2)])
def test_place(rng, up):
    """A rigid motion of the rest pose: its up along `up`, its forward in the plane of `up` and heading."""
    body, at = human(), rng.normal(size=3).astype(np.float32)
    up, heading = np.array(up, np.float32), np.array([0.3, -0.4, 0.5], np.float32)
    poses = place(body, at, up, heading)
    q = Rotation.from_quat(np.asarray(poses.rotation), scalar_first=True)
    rest = Rotation.from_quat(np.asarray(body.rest.rotation), scalar_first=True)
    turn = (q * rest.inv()).as_matrix()
    np.testing.assert_allclose(turn, np.broadcast_to(turn[0], turn.shape), atol=1e-5)
    np.testing.assert_allclose(turn[0] @ [0, 0, 1], up / np.linalg.norm(up), atol=1e-5)
    assert np.linalg.det(turn[0]) == pytest.approx(1, abs=1e-5)
    assert turn[0][:, 0] @ heading > 0 and abs(turn[0][:, 1] @ heading) < 1e-5
    moved = np.asarray(body.rest.translation) @ turn[0].T + at
    np.testing.assert_allclose(poses.translation, moved, atol=1e-5)


@pytest.mark.parametrize("where", [(2.5, 0.0), (0.0, -3.0), (-1.5, 2.0)])
@pytest.mark.parametrize("count", [1, 4, 12])
def test_standing_places(where, count):
    """Feet on the floor below the cloud, headings evenly spread, the first one towards the sensor."""
    body = human()
    frame = column(1.75, 0.0, count=6)
    frame = replace(frame, points=frame.points + np.array([*where, 0], np.float32))
    places = standing_places(body, [frame], FLOOR, count)
    assert len(places) == count
    rest = Rotation.from_quat(np.asarray(body.rest.rotation[0]), scalar_first=True)
    turns = [Rotation.from_quat(np.asarray(p.rotation[0]), scalar_first=True) * rest.inv() for p in places]
    forward = np.array([t.apply([1, 0, 0]) for t in turns])
    towards = -np.array([*where, 0.0]) / np.linalg.norm(where)
    np.testing.assert_allclose(np.linalg.norm(forward, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose([t.apply([0, 0, 1]) for t in turns], np.tile(UP, (count, 1)), atol=1e-5)
    np.testing.assert_allclose(forward[0], towards, atol=1e-3)
    angles = np.sort(np.arctan2(forward[:, 1], forward[:, 0]))
    np.testing.assert_allclose(np.diff(angles), 2 * np.pi / count, atol=1e-4)
    ankles = ("l_talocrural", "r_talocrural")
    for poses in places:
        centres = np.asarray(jax.jit(joint_centres)(body, poses))
        feet = np.mean([centres[body.topology.centres.index(a)] for a in ankles], 0)
        # the axis lies behind the seen surface
        assert np.linalg.norm(feet[:2] - np.array(where)) < 0.25 and 0 < feet[2] < 0.15
        assert (feet[:2] - np.array(where)) @ towards[:2] < 0.05


def test_a_cloud_right_below_the_sensor_has_headings_too():
    frame = column(1.75, 0.0, origin=(0.0, 0.0, 3.0))
    places = standing_places(human(), [frame], FLOOR, 3)
    assert all(np.isfinite(np.asarray(p.rotation)).all() for p in places)


def test_sized():
    body, frames = human(), [column(1.9, 3.0)] * 4
    assert float(sized(body, frames, FLOOR, StartSettings(scale=1.6)).scale) == pytest.approx(1.6)
    assert float(sized(body, frames, FLOOR, StartSettings()).scale) == pytest.approx(1.9, abs=0.03)
    assert float(sized(body, [], FLOOR, StartSettings()).scale) == pytest.approx(float(body.scale))
    arm = load_body("arm")
    low = [column(2 * rest_height(arm), 2.0)] * 3
    assert float(sized(arm, low, FLOOR, StartSettings()).scale) == pytest.approx(2 * float(arm.scale), rel=0.03)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_the_right_heading_is_found(degrees, tmp_path):
    """A person who stands still with her feet in view, turned anywhere; 180 faces the camera."""
    body = scaled(human(), 1.8)
    moved = placed(make_motion(body, "stand", 0.6, 12.0), 3.6, 0.0, np.radians(degrees))
    sim = simulate(body, moved, tof_camera(1.0, 0.07))
    tracks = track(human(), read_log(write_simulation(sim, tmp_path / "turned.mcap")), Settings())
    assert tracks.tracked.all() and abs(float(tracks.body.scale) - 1.8) < 0.035
    across = lambda joints: joints[:, names.index("l_hip")] - joints[:, names.index("r_hip")]  # noqa: E731
    names = body.topology.centres
    found, true = across(tracks.joints), across(sim.joints)
    cosine = np.sum(found * true, 1) / np.linalg.norm(found, axis=1) / np.linalg.norm(true, axis=1)
    assert cosine.min() > np.cos(np.radians(20))
    assert np.linalg.norm(tracks.joints - sim.joints, axis=-1).mean() < 0.03


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Runs trials on some frames of a person who stands with the back to the camera, padded to `length` frames."""
    sim = simulate(scaled(human(), 1.8), placed(make_motion(human(), "stand", 0.6, 12.0), 3.6, 0.0, 0.0), tof_camera())
    recording, settings = read_log(write_simulation(sim, tmp_path_factory.mktemp("back") / "back.mcap")), Settings()
    body = scaled(human(), 1.8)
    scene, people = find_body(recording, recording.up, body, settings)
    options = options_from(settings.solve, settings.track, settings.features)

    def run(count: int, length: int, headings: int, chunk: int = 128):
        few = replace(settings, start=replace(settings.start, frames=length), detect=DetectSettings(points=256))
        few = replace(few, track=replace(settings.track, chunk=chunk))
        starts = standing_places(body, people[:count], scene.floor, headings)
        return Runner(body, options, people, scene, few).trials(body, people[:count], starts)

    return run


def test_frames_without_points_do_not_count_in_trials(trials):
    plain, padded = trials(3, 3, 4), trials(3, 6, 4)
    np.testing.assert_array_equal(plain.cost, padded.cost)
    np.testing.assert_array_equal(plain.state.poses.translation, padded.state.poses.translation)


def test_trials_in_pieces_are_the_same(trials, monkeypatch):
    """More trials than are tracked at once: 18 of 2 frames each, where 16 fit in, and three where 7 frames do."""
    monkeypatch.setattr(
        "voodoo_jax.trackers.icp.trials.FUNNEL", ((2, 4),)
    )  # all that are given up have come equally far
    many = trials(3, 6, 18)
    for chunk, headings in ((128, 9), (7, 18)):
        other = trials(3, 6, headings, chunk)
        kept = np.isfinite(other.cost)
        assert kept.sum() == 4
        if headings == 18:
            np.testing.assert_array_equal(other.cost, many.cost)
            np.testing.assert_array_equal(other.state.poses.rotation, many.state.poses.rotation)
        else:  # every second one
            np.testing.assert_array_equal(other.state.poses.rotation[~kept], many.state.poses.rotation[::2][~kept])


def test_trials_that_are_given_up_are_not_the_best(trials, monkeypatch):
    """Who goes on comes out as if all did, the best among them, and one that faces the other way and is as good."""
    monkeypatch.setattr(
        "voodoo_jax.trackers.icp.trials.STEPS", Settings().solve.max_steps
    )  # as without others to give up
    some = trials(5, 5, 12)
    monkeypatch.setattr("voodoo_jax.trackers.icp.trials.FUNNEL", ((2, 12),))
    every = trials(5, 5, 12)
    kept = np.isfinite(some.cost)
    assert kept.sum() == 4 and np.isfinite(every.cost).all()
    np.testing.assert_allclose(some.cost[kept], every.cost[kept], rtol=1e-5)
    assert np.argmin(some.cost) == np.argmin(every.cost)
    front = facing(human(), every.state.poses.rotation)
    other = front @ front[np.argmin(every.cost)] < 0
    # a rival may cost a tenth more
    assert np.min(some.cost[other]) == pytest.approx(np.min(every.cost[other]), rel=0.03)
