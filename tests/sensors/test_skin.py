"""Skin colour: regions in drawn images, and rays through known points from logs with a colour camera."""

import cv2
import numpy as np
import pytest

from tests.support.colour_logs import ros_compressed, ros_info, ros_raw
from tests.support.logs import PERIOD, START, Log, depth_log, detections, ros_tf
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry import lens
from voodoo_jax.io.log_reader import read_log, survey
from voodoo_jax.sensors.skin_colour import SkinFinder

SKIN, BROWN = (115, 140, 200), (88, 104, 124)  # blue, green, red
K = np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]])
SIZE = (240, 320)
EYE = np.array([0.2, -0.1, 1.4])  # of the colour camera in `base`, looking along x
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
FACE, HANDS = np.array([2.0, 0.0, 1.7]), (np.array([1.8, 0.5, 1.2]), np.array([1.8, -0.6, 1.3]))
SEARCH = ReadSettings(skin=True)


def draw(spots, light: float = 1.0, floor: bool = True, rng=None, colour=SKIN) -> np.ndarray:
    """A room with round spots of skin: (u, v, radius)."""
    image = np.full((*SIZE, 3), (150, 160, 160), np.uint8)
    if floor:
        image[170:] = BROWN
    for u, v, r in spots:
        cv2.circle(image, (round(u * 16), round(v * 16)), round(r * 16), colour, -1, shift=4)
    noise = 0 if rng is None else rng.normal(0, 4, image.shape)
    return np.clip(image * light + noise, 0, 255).astype(np.uint8)


def found(centres, u, v) -> float:
    return float(np.linalg.norm(centres - [u, v], axis=1).min(initial=np.inf))


@pytest.mark.parametrize("light", [0.5, 1.0, 1.25])
def test_face_and_hands_but_no_floor(rng, light):
    finder = SkinFinder()
    for i in range(3):
        spots = [(150 + i, 50, 12), (90, 110 + 3 * i, 7), (210, 100, 7)]
        regions = finder.find(draw(spots, light, rng=rng))
        assert len(regions.centres) == 3
        assert all(found(regions.centres, u, v) < 1.5 for u, v, _ in spots)
        grown = np.sqrt(np.sort(regions.areas) / np.pi) - [7, 7, 12]  # by the image's blur
        assert (np.abs(grown - 1) < 1.2).all()
        assert (0 <= regions.scores).all() and (regions.scores <= 1).all()


def test_a_hand_before_a_brown_floor(rng):
    """It is one with the floor by the range of skin colours alone; the model tells them apart once it knows skin."""
    finder = SkinFinder()
    for i in range(20):
        regions = finder.find(draw([(150, 50, 12), (90, 120 + 5 * i, 8)], rng=rng))
        assert found(regions.centres, 150, 50) < 1.5 and found(regions.centres, 90, 120 + 5 * i) < 3


def test_a_forearm_gives_both_ends():
    image = draw([], floor=False)
    cv2.line(image, (100, 60), (160, 140), SKIN, 12)
    centres = SkinFinder().find(image).centres
    assert len(centres) == 2 and found(centres, 106, 68) < 9 and found(centres, 154, 132) < 9


def test_nothing_there():
    finder = SkinFinder()
    for image in (draw([], floor=False), np.zeros((10, 10, 3), np.uint8), np.full((*SIZE, 3), SKIN, np.uint8)):
        assert finder.find(image).centres.shape == (0, 2)


def test_large_images(rng):
    image = cv2.resize(draw([(150, 50, 12)], rng=rng), None, fx=5, fy=5, interpolation=cv2.INTER_LINEAR)
    regions = SkinFinder().find(image)
    assert found(regions.centres, 150.5 * 5 - 0.5, 50.5 * 5 - 0.5) < 5
    np.testing.assert_allclose(regions.areas, [25 * np.pi * 13**2], rtol=0.1)


def pixel(point, d=()) -> np.ndarray:
    x, y, z = np.asarray(point) - EYE
    ray = np.array([-y, -z]) / x
    return K[:2, :2] @ (lens.distort(ray, np.array(d), "plumb_bob") if d else ray) + K[:2, 2]


def spots_of(points, d=()) -> list:
    return [(*pixel(p, d), 9.0) for p in points]


def colour(log: Log, d=()) -> Log:
    log.add("/tf_static", START, ros_tf((START, "base", "colour", tuple(EYE), OPTICAL)))
    return log.add("/colour/camera_info", START, ros_info("colour", K, SIZE, d))


def check_ray(frame, point, names=("skin",), within=0.02) -> None:
    """Some ray of the frame passes the point."""
    to = np.asarray(point) - frame.rays.origins
    across = np.linalg.norm(to - np.sum(to * frame.rays.directions, 1, keepdims=True) * frame.rays.directions, axis=1)
    good = [n in names for n in frame.rays.names]
    assert across[good].min() < within
    np.testing.assert_allclose(np.linalg.norm(frame.rays.directions, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(frame.rays.origins, np.tile(EYE, (len(to), 1)), atol=1e-5)


@pytest.mark.parametrize("d", [(), (-0.28, 0.07, 0.0002, -0.0005, 0.0)])
def test_rays_through_face_and_hands(tmp_path, d):
    log = colour(depth_log(3), d)
    for i in (0, 2):
        stamp = START + i * PERIOD + 4_000_000  # of the nearest frame, as detections
        image = draw(spots_of([FACE, *HANDS], d), floor=False)
        log.add("/colour/image/compressed", stamp, ros_compressed(stamp, "colour", image, ".png", "png"))
    path = log.write(tmp_path / "a.mcap")
    recording = read_log(path, SEARCH)
    assert recording.notes == () and recording.features == ("/colour/image/compressed",)
    assert [f.rays.names for f in recording] == [("skin",) * 3, (), ("skin",) * 3]
    for point in (FACE, *HANDS):
        check_ray(recording.frames[2], point)
    assert {t.topic: t.use for t in survey(path, SEARCH).topics}["/colour/image/compressed"] == "skin colour"
    assert read_log(path).features == () and read_log(path).frames[0].rays.names == ()


def test_beside_detections_and_with_a_weight(tmp_path):
    log = colour(depth_log(1))
    name, data, text = detections(START, "colour", [([("left_hand", 0.9)], *pixel(HANDS[0]))])
    log.schema_text[name] = text
    log.add("/colour/found", START, (name, data))
    log.add("/colour/image", START, ros_raw(START, "colour", "bgr8", draw(spots_of([FACE]), floor=False)))
    settings = ReadSettings(skin=True, weights=("/colour/image=0.5",))
    recording = read_log(log.write(tmp_path / "a.mcap"), settings)
    frame = recording.frames[0]
    assert frame.rays.names == ("left_hand", "skin") and recording.notes == ()
    assert recording.features == ("/colour/found", "/colour/image")
    check_ray(frame, FACE)
    check_ray(frame, HANDS[0], ("left_hand",))
    assert frame.rays.weights is not None and frame.rays.weights.tolist() == [1.0, 0.5]


def test_furniture_that_never_moves_is_left_out(tmp_path):
    log = colour(depth_log(100))
    still = (40.0, 200.0, 10.0)
    for i in range(0, 100, 5):
        point = FACE + [0, 0.3 * np.sin(i / 15), 0]
        stamp = START + i * PERIOD
        image = draw([*spots_of([point]), still], floor=False)
        log.add("/colour/image", stamp, ros_compressed(stamp, "colour", image, ".jpg"))
    recording = read_log(log.write(tmp_path / "a.mcap"), SEARCH)
    assert [f.rays.names for f in recording] == ([("skin",)] + [()] * 4) * 20
    check_ray(recording.frames[40], FACE + [0, 0.3 * np.sin(40 / 15), 0])
    assert "20 messages with skin-coloured regions that never move, which are left out" in recording.notes[0]
    log.items = [item for item in log.items if item[1] < START + 80 * PERIOD]
    short = read_log(log.write(tmp_path / "b.mcap"), SEARCH)  # too short to tell
    assert [f.rays.names for f in short] == ([("skin", "skin")] + [()] * 4) * 16


def test_somebody_who_stands_still_is_kept(tmp_path):
    log = colour(depth_log(95))
    image = draw(spots_of([FACE]), floor=False)
    for i in range(0, 95, 4):
        log.add("/colour/image", START, ros_compressed(START + i * PERIOD, "colour", image))
    recording = read_log(log.write(tmp_path / "a.mcap"), SEARCH)
    assert recording.notes == () and all(f.rays.names == ("skin",) for f in recording.frames[::4])


def test_what_cannot_be_used_is_said(tmp_path):
    log = depth_log(2)
    assert read_log(log.write(tmp_path / "a.mcap"), SEARCH).notes == (
        "read.skin has no effect: the log has no calibrated colour images.",
    )
    log.add("/bare/image", START, ros_compressed(START, "nowhere", draw([])))
    log.add("/grey/image", START, ros_raw(START, "grey", "mono8", draw([])[..., :1]))
    notes = read_log(log.write(tmp_path / "b.mcap"), SEARCH).notes
    assert notes[0] == "Skin detection leaves out '/bare/image': it has no calibration." and len(notes) == 2
    colour(log)
    for i in range(2):
        log.add("/colour/image", START, ros_compressed(START + i * PERIOD, "colour", draw(spots_of([FACE]))))
    log.items[-1][2].data = log.items[-1][2].data[:300]
    recording = read_log(log.write(tmp_path / "c.mcap"), SEARCH)
    assert "'/colour/image': 1 message cannot be decoded, left out of skin detection." in recording.notes
    assert [len(f.rays.names) for f in recording] == [1, 0]
