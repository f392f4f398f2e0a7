"""Key points of several cameras alone: triangulated, and told apart by people."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.logs import START, Log, detections, ros_calibration, ros_tf
from voodoo_jax.io.key_points import order_of, people_of, sights, triangulated
from voodoo_jax.io.log_reader import read_log

NAMES = ("nose", *(f"{side}_{n}" for n in "shoulder elbow wrist hip knee ankle".split() for side in ("left", "right")))
HEIGHTS = np.array([1.6, 1.4, 1.4, 1.1, 1.1, 0.9, 0.9, 0.9, 0.9, 0.5, 0.5, 0.1, 0.1])
ACROSS = np.array([0.0, 0.2, -0.2, 0.25, -0.25, 0.3, -0.3, 0.1, -0.1, 0.12, -0.12, 0.12, -0.12])
CAMERAS = [(3.0, 0, 1.5), (-2.0, 2.5, 1.8), (-2.0, -2.5, 1.2), (0.0, 3.5, 2.0)]
FRAMES = 20


def person(x, y, i):
    """Somebody who walks along y, and lifts the left hand."""
    points = np.stack([np.full(len(NAMES), x), y + 0.02 * i + ACROSS, HEIGHTS], -1)
    points[5, 2] += 0.03 * i
    return points


def looks(camera, people, rng, missing=0.0, wrong=0.0):
    """What a camera sees of people: with noise, points that are missing and wrong, in their order."""
    origin, names, ways = np.array(CAMERAS[camera]), [], []
    for points in people:
        for name, at in zip(NAMES, points):
            if rng.random() < missing:
                continue
            way = at - origin + (rng.normal(0, 0.5, 3) if rng.random() < wrong else rng.normal(0, 0.004, 3))
            names.append(name)
            ways.append(way / np.linalg.norm(way))
    return sights(origin, names, np.array(ways), np.ones(len(names)), NAMES)


def test_the_order_of_names():
    """As the fullest person has it, whoever comes first."""
    names, stamps = ["a", "c", "a", "b", "c", "a", "b", "c", "d", "b", "d"], np.array([1] * 5 + [2] * 6)
    assert order_of(names, stamps) == ("a", "b", "c", "d")


def test_one_point():
    rng = np.random.default_rng(0)
    at = person(0, 0, 3)
    found = triangulated([looks(c, [at], rng, wrong=0.1 if c else 0.0)[0] for c in range(4)])
    assert set(found) == set(NAMES)
    off = [np.linalg.norm(found[name] - at[k]) for k, name in enumerate(NAMES)]
    assert np.median(off) < 0.01 and np.mean(np.array(off) < 0.03) > 0.8


@pytest.mark.parametrize("count", [1, 2, 3])
def test_people_are_told_apart(count):
    """They stand a step apart, some points are missing, some wrong, and a camera sees the second one late."""
    rng, where = np.random.default_rng(1), [(0.0, 0.0), (0.9, -0.4), (-0.8, 0.5)][:count]
    frames, truth = {}, {}
    for i in range(FRAMES):
        truth[i] = [person(*at, i) for at in where]
        order = [rng.permutation(count) for _ in CAMERAS]
        seen = [[truth[i][k] for k in order[c] if not (c == 2 and k == 1 and i < 8)] for c in range(4)]
        frames[i] = [looks(c, people, rng, missing=0.1, wrong=0.05) if people else [] for c, people in enumerate(seen)]
    pairs, rays = people_of(frames)
    assert len(pairs) == FRAMES
    whose = {name.partition(":")[0] if count > 1 else "" for p in pairs.values() for name in p.names}
    assert len(whose) == count
    owner: dict[str, set[int]] = {}
    off = []
    for i, p in pairs.items():
        for name, at in zip(p.names, p.points):
            one, _, point = name.rpartition(":")
            away = [np.linalg.norm(at - body[NAMES.index(point)]) for body in truth[i]]
            if min(away) < 0.1:
                owner.setdefault(one, set()).add(int(np.argmin(away)))
            off.append(min(away))
        assert len(rays[i].names) > 2 * len(p.names) * 0.8 and set(rays[i].names) == set(p.names)
    assert all(len(bodies) == 1 for bodies in owner.values())  # nobody becomes somebody else
    assert np.median(off) < 0.01 and np.mean(np.array(off) < 0.05) > 0.97


def test_a_log_of_key_points(tmp_path):
    """Detections of four calibrated cameras become 3D points in the fixed frame, and stay lines of sight."""
    log, rng = Log(), np.random.default_rng(2)
    K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    turns = []
    for c, place in enumerate(CAMERAS):
        ahead = np.array([0, 0.2, 1.0]) - place
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        turns.append(np.stack([right, np.cross(ahead, right), ahead], 1))
        q = tuple(Rotation.from_matrix(turns[-1]).as_quat().tolist())
        log.add("/tf_static", START, ros_tf((START, "room", f"cam{c}", place, q)))
        log.add(f"/cam{c}/camera_info", START, ros_calibration(f"cam{c}", K, size=(480, 640)))
    for i in range(4):
        stamp = START + i * 10**8
        for c, place in enumerate(CAMERAS):
            at = (person(0, 0, i) - place) @ turns[c]
            pixels = at[:, :2] / at[:, 2:] * 600 + [320, 240] + rng.normal(0, 0.5, (len(NAMES), 2))
            items = [([(name, 0.9)], u, v) for name, (u, v) in zip(NAMES, pixels)]
            kind, message, text = detections(stamp, f"cam{c}", items)
            log.schema_text[kind] = text
            log.add(f"/cam{c}/detections", stamp, (kind, message))
    found = read_log(log.write(tmp_path / "a.mcap"))
    assert len(found) == 4 and len(found.frames[2].rays.names) > 40
    points = dict(zip(found.frames[2].pairs.names, found.frames[2].pairs.points))
    off = [np.linalg.norm(points[name] - at) for name, at in zip(NAMES, person(0, 0, 2))]
    assert max(off) < 0.02
