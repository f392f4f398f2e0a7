"""Simulated colour recordings: both cameras see the same places, people look as they are dressed, logs read back."""

from dataclasses import replace

import numpy as np
import pytest

from voodoo_jax.cli import demo
from voodoo_jax.cli.main import main
from voodoo_jax.config.presets import preset
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.colour import picture, room_picture, simulate_colour, stereo_cameras, surface
from voodoo_jax.simulate.looks import Look, Paint, Scenery, body_colours, fractal, random_look, random_scenery
from voodoo_jax.simulate.mcap import write_colour
from voodoo_jax.simulate.motion import make_motion, placed, pose_body
from voodoo_jax.simulate.recording import render
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import NO_NOISE, Camera

SMALL = Camera(80, 60, 66.0, 66.0, 39.5, 29.5, (0.0, 0.0, 1.3), 0.16)
PLAIN = Scenery(light=(0.0, 0.0, 1.0), ambient=1.0)


def standing(frames: int = 1):
    body = load_body("human")
    return body, placed(make_motion(body, "stand", frames / 10, 10.0), 2.5, 0.0, np.pi)


def test_both_cameras_see_the_same_places():
    """What the left camera sees at a place has the same colour where the right one sees it, and not beside it."""
    body, motion = standing()
    poses = pose_body(body, motion.root, motion.rotations)[0]
    left, right = stereo_cameras(width=320)
    assert np.linalg.norm(np.subtract(left.position, right.position)) == pytest.approx(0.11)
    look = Look(shirt=Paint((50, 80, 160), 0.3), trousers=Paint((90, 90, 90), 0.3))
    views = [picture(body, poses, c, room_picture(c, Room(), PLAIN), look, PLAIN) for c in (left, right)]
    seen, other = surface(body, poses, left), surface(body, poses, right)
    points = np.array(left.position) + left.rays(seen.pixel) * seen.depth[:, None]
    local = (points - np.array(right.position)) @ right.rotation
    u, v = (local[:, :2] / local[:, 2:] * [right.fx, right.fy] + [right.cx, right.cy]).T
    np.testing.assert_allclose(v, seen.pixel // left.width, atol=1e-6)  # rectified
    depth = np.full(right.width * right.height, np.inf)
    depth[other.pixel] = other.depth
    at = v.round().astype(int) * right.width + u.round().astype(int)
    both = np.abs(depth[at] - local[:, 2]) < 0.01  # not hidden there
    assert both.sum() > 2000
    colour = views[0].reshape(-1, 3)[seen.pixel[both]]
    near, beside = (np.abs(views[1].reshape(-1, 3)[at[both] + k] - colour).mean() for k in (0, 4))
    assert near < 3 and beside > 3 * near


def test_the_body_is_that_of_the_depth_camera_with_closed_joints():
    body, motion = standing()
    poses = pose_body(body, motion.root, motion.rotations)[0]
    depth = render(body, poses, SMALL, None)[0].ravel()
    seen = surface(body, poses, SMALL)
    there = np.isfinite(depth)
    with_balls = np.full(len(depth), np.inf)
    with_balls[seen.pixel] = seen.depth
    assert (with_balls[there] <= depth[there] + 1e-9).all() and (with_balls[there] == depth[there]).mean() > 0.95
    added = np.isfinite(with_balls) & ~there
    assert 0 < added.sum() < 0.1 * there.sum()
    # the neck, where the built-in body has nothing
    up = (np.array(SMALL.position) + SMALL.rays() * np.where(added, with_balls, 0)[:, None])[added, 2]
    assert ((up > 0.835 * 1.7) & (up < 0.885 * 1.7)).any()
    toward = (seen.normal * SMALL.rays(seen.pixel)).sum(1)
    assert (toward <= 0).all() and np.allclose(np.linalg.norm(seen.normal, axis=1), 1)


def test_people_look_as_they_are_dressed():
    body = load_body("human")
    limbs, stature = body.topology.limbs, float(body.scale)
    flat = lambda r: Paint((r, 0, 0), 0.0)  # noqa: E731
    look = Look(flat(10), flat(20), flat(30), flat(40), flat(50), sleeve=0.7, hem=0.3)

    def red(limb: str, *share: float) -> float:
        return float(body_colours(body, look, np.array([limbs.index(limb)]), np.array([share]) * stature)[0, 0])

    assert [red("l_upper_arm", 0, 0.1, z) for z in (0.78, 0.66)] == [30, 10]  # short sleeves
    assert [red("r_thigh", 0, -0.06, 0.4), red("r_shank", 0, -0.06, 0.2), red("r_foot", 0, -0.06, 0)] == [40, 10, 50]
    assert [red("pelvis", 0, 0, z) for z in (0.6, 0.5)] == [30, 40]
    assert [red("head", 0.06, 0, 0.93), red("head", -0.05, 0, 0.93), red("head", 0, 0, 1)] == [10, 20, 20]
    assert red("head", 0.06, 0.018, 0.94) < 10  # an eye
    dog = load_body("dog")
    colours = body_colours(dog, look, np.arange(dog.limb_count), np.zeros((dog.limb_count, 3)))
    assert (colours[:, 0] == 10).all()


def test_looks_and_rooms_differ_by_their_seed():
    looks = [random_look(np.random.default_rng(k)) for k in (0, 0, 1)]
    rooms = [random_scenery(np.random.default_rng(k)) for k in (0, 0, 1)]
    assert looks[0] == looks[1] != looks[2] and rooms[0] == rooms[1] != rooms[2]
    places = np.random.default_rng(0).uniform(-3, 3, (4000, 3))
    assert fractal(places, 0.3, 0.01, 5).std() == pytest.approx(1, abs=0.1)
    np.testing.assert_array_equal(fractal(places, 0.3, 0.01, 5)[:9], fractal(places[:9], 0.3, 0.01, 5))


def test_logs_read_back(tmp_path):
    body, motion = standing(2)
    pair = (SMALL, replace(SMALL, position=(0.0, -0.1, 1.3)))
    stereo, depth = (
        simulate_colour(body, motion, cameras, other, noise=NO_NOISE)
        for cameras, other in ((pair, None), ((SMALL,), replace(SMALL, position=(0.0, 0.05, 1.3))))
    )
    paths = [write_colour(s, tmp_path / f"{n}.mcap") for n, s in (("a", stereo), ("b", depth), ("c", depth))]
    assert paths[1].read_bytes() == paths[2].read_bytes()
    for path, sim, baseline in zip(paths, (stereo, depth), (0.1, 0.0)):
        recording = read_log(path, preset("flexible").read)
        assert [f.time_ns for f in recording] == sim.time_ns.tolist()
        for i, frame in enumerate(recording):
            (shot,) = frame.pictures
            images = shot.unpack()
            assert shot.baseline == pytest.approx(baseline) and len(images) == len(sim.images)
            for image, exact in zip(images, sim.images):
                assert np.abs(image[..., ::-1].astype(float) - exact[i]).mean() < 6  # JPEG of little, noisy images
    frame = read_log(paths[1], preset("flexible").read).frames[0]
    z = depth.depth[0].reshape(-1, 1) / 1000
    expected = (SMALL.rays() * z + [0.0, 0.05, 1.3])[z[:, 0] > 0.1]
    assert len(frame.points) == len(expected) and np.abs(frame.points.mean(0) - expected.mean(0)).max() < 1e-3
    with np.load(paths[0].with_name("a.truth.npz")) as truth:
        np.testing.assert_array_equal(truth["joints"], stereo.joints)


def test_the_second_demo(tmp_path, monkeypatch, capsys):
    """A short one: simulated, tracked, compared with the truth and drawn."""
    monkeypatch.setattr(demo, "PARTS", (("stand", 0.4), ("wave", 0.67)))
    assert main(["demo", "--tracker", "flexible", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    error = float(printed.partition("all joints")[2].split()[0])
    assert 0.5 < error < 5 and "l_radiocarpal" in printed
    assert {p.name for p in tmp_path.iterdir()} >= {
        "demo-flexible.mcap", "demo-flexible.truth.npz", "demo-flexible.tracks.npz", "demo-flexible.png",
    }  # fmt: skip
