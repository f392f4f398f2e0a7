"""Key points by a network: what is done before and after it; and the network itself where [pose] is installed."""

import zipfile
from importlib.util import find_spec
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest

from voodoo_jax.config.options import SettingsError
from voodoo_jax.sensors.pose_net import (
    FILES,
    KEY_POINTS,
    PoseNet,
    Region,
    anchors,
    around,
    best_detection,
    cropped,
    pose_files,
    refined,
)


def logit(p):
    return np.log(p / (1 - p))


@pytest.mark.parametrize("angle", [0.0, 0.6, -2.5])
def test_a_region_is_cut_out_where_it_is(angle):
    """A spot in the image is where the region's own coordinates say, to a third of a pixel of the square."""
    v, u = np.mgrid[:240, :320]
    region, spot = Region(np.array([150.0, 120.0]), 160.0, angle), np.array([120.5, 133.0])
    bright = 200 * np.exp(-((u - spot[0]) ** 2 + (v - spot[1]) ** 2) / 18)
    square = cropped(np.stack([bright, 0 * bright, 0 * bright], -1).astype(np.uint8), region, 256)
    assert (
        square.shape == (256, 256, 3) and square.dtype == np.float32 and square[..., :2].max() == 0
    )  # blue comes last
    rows, columns = np.mgrid[:256, :256]
    place = np.array([(columns * square[..., 2]).sum(), (rows * square[..., 2]).sum()]) / square[..., 2].sum() / 256
    np.testing.assert_allclose(region.to_image @ [*place, 1], spot, atol=0.3)
    assert 0.7 < square.max() < 0.8  # 200 of 255


def test_outside_of_the_image_is_black():
    square = cropped(np.full((40, 60, 3), 255, np.uint8), Region(np.array([30.0, 20.0]), 60.0, 0.0), 60)
    assert square[:9].max() == 0 and square[-9:].max() == 0 and square[12:48].min() == 1


def test_detections_of_one_person_are_averaged():
    """The box comes as centre and size, key points beside the anchor, all in pixels of the detector's square."""
    places, n = anchors(), 224
    assert len(places) == 28 * 28 * 2 + 14 * 14 * 2 + 7 * 7 * 6
    raw, scores = np.zeros((len(places), 12)), np.full(len(places), -50.0)
    key = np.array([[0.5, 0.6], [0.5, 0.1], [0.5, 0.4], [0.5, 0.2]])  # hips, circle, shoulders, circle

    def put(k, centre, shift, score):
        raw[k] = np.concatenate([[np.add(centre, shift) - places[k], [0.2, 0.2]], key + shift - places[k]]).ravel() * n
        scores[k] = logit(score)

    put(700, [0.5, 0.3], 0.0, 0.9)
    put(1600, [0.5, 0.3], 0.01, 0.6)  # the same person
    put(2200, [0.1, 0.3], -0.4, 0.8)  # somebody else
    put(10, [0.5, 0.3], 0.3, 0.4)  # not sure
    found = best_detection(raw, scores)
    assert found is not None
    shift = 0.01 * 0.6 / 1.5
    np.testing.assert_allclose(found[:2], [[0.4 + shift, 0.2 + shift], [0.6 + shift, 0.4 + shift]], atol=1e-6)
    np.testing.assert_allclose(found[2:], key + shift, atol=1e-6)
    assert best_detection(raw, np.full(len(places), -50.0)) is None


def test_the_square_around_a_person():
    upright, lying = (around(np.array([50.0, 80.0]), np.array(far)) for far in ([50.0, 40.0], [90.0, 80.0]))
    assert (upright.size, upright.angle) == (100.0, 0.0) and lying.angle == pytest.approx(np.pi / 2)
    # straight above the middle of the square is where the person's head is
    np.testing.assert_allclose(lying.to_image @ [0.5, 0.1, 1], [90, 80], atol=1e-9)


def test_heat_maps_move_key_points_where_they_are_sure():
    v, u = np.mgrid[:64, :64]
    sure = logit(0.9 * np.exp(-((u - 31) ** 2 + (v - 21) ** 2) / 2) + 1e-4)
    maps = np.stack([sure, sure - 5, sure, sure], -1)
    places = np.array([[30.2, 20.4], [30.2, 20.4], [70.0, 3.0], [1.0, 63.0]]) / 64
    out = refined(places, maps) * 64
    np.testing.assert_allclose(out, [[31, 21], [30.2, 20.4], [70, 3], [1, 63]], atol=0.02)


def test_where_the_networks_are(tmp_path, monkeypatch):
    package = tmp_path / "mediapipe"
    for name in FILES:
        (package / "modules" / name).parent.mkdir(parents=True)
        (package / "modules" / name).write_bytes(name.encode())
    (package / "__init__.py").write_text("raise SystemExit('it is not imported')")
    expected = tuple(name.encode() for name in FILES)
    with zipfile.ZipFile(tmp_path / "some.whl", "w") as wheel:
        for name in FILES:
            wheel.writestr(f"mediapipe/modules/{name}", name)
    assert pose_files(str(tmp_path / "some.whl")) == pose_files(str(package)) == expected
    monkeypatch.syspath_prepend(str(tmp_path))
    if find_spec("mediapipe").origin == str(package / "__init__.py"):  # else another one was found before
        assert pose_files("mediapipe") == expected
    (package / "modules" / FILES[0]).unlink()
    with zipfile.ZipFile(tmp_path / "empty.whl", "w") as wheel:
        wheel.writestr("mediapipe/__init__.py", "")
    (tmp_path / "no.whl").write_bytes(b"no wheel")
    for place in ("empty.whl", "no.whl", "mediapipe", "nowhere"):
        with pytest.raises(SettingsError, match=f"read.pose_net: .*{place}"):
            pose_files(str(tmp_path / place))


def test_the_network_finds_a_person():
    """On the portrait that matplotlib brings along: face and shoulders are seen, the rest is known not to be."""
    pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed ([pose])")
    if find_spec("mediapipe") is None:
        pytest.skip("the networks are not installed ([pose])")
    image = cv2.imread(str(Path(matplotlib.get_data_path()) / "sample_data" / "grace_hopper.jpg"))
    net = PoseNet(pose_files("mediapipe"))
    first, second = net.find(image), net.find(image)  # by the detector, then where the person was
    assert first is not None and second is not None
    # read off the picture, pixels; the person is 1,400 pixels tall
    by_hand = {"left_eye": (294, 190), "right_eye": (229, 190), "mouth_left": (288, 277), "left_shoulder": (435, 395)}
    for found in (first, second):
        for name, (u, v) in by_hand.items():
            k = KEY_POINTS.index(name)
            assert np.hypot(*(found.pixels[k] - [u, v])) < 30 and found.scores[k] > 0.8, name
        assert found.scores[KEY_POINTS.index("left_knee")] < 0.1
    # turned by a right angle: the same places
    turned = PoseNet(pose_files("mediapipe")).find(cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE))
    assert turned is not None
    eye = turned.pixels[KEY_POINTS.index("left_eye")]
    assert np.hypot(*(eye - [599 - 190, 294])) < 30
    assert net.find(np.zeros((240, 320, 3), np.uint8)) is None
