"""Images of another size than their calibration: scaled, cropped, or a question."""

import numpy as np
import pytest

from tests.support.logs import START, Log, ros_calibration, ros_image
from voodoo_jax.io.log_reader import LogError, open_log, read_log

WIDE = np.array([[120.0, 0, 32.0], [0, 118.0, 22.5], [0, 0, 1]])
SHAPE = 48, 64
FULL = 1.5 + 0.01 * np.add.outer(np.arange(48.0), np.arange(64.0)).round(3)


def points(metres: np.ndarray, calibration, tmp_path) -> tuple[np.ndarray, tuple[str, ...]]:
    log = Log().add("/d", START, ros_image(START, "cam_optical", metres)).add("/i", START, calibration)
    recording = read_log(log.write(tmp_path / "a.mcap"))
    return recording.frames[0].points, recording.notes


def expected(rows: slice, columns: slice) -> np.ndarray:
    """What these pixels of the whole image show."""
    v, u = np.mgrid[rows, columns]
    z = FULL[rows, columns]
    return np.stack([(u - 32.0) / 120 * z, (v - 22.5) / 118 * z, z], -1).reshape(-1, 3)


def info(**changed):
    made = ros_calibration("cam_optical", WIDE, size=SHAPE)
    for name, value in changed.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize(
    "rows, columns, said",
    [
        (slice(0, 48), slice(0, 64), ""),
        (slice(6, 42), slice(0, 64), "cropped about its centre"),  # a band
        (slice(0, 48), slice(10, 54), "cropped about its centre"),
    ],
)
def test_a_crop_leaves_pixels_square(tmp_path, rows, columns, said):
    found, notes = points(FULL[rows, columns], info(), tmp_path)
    np.testing.assert_allclose(found, expected(rows, columns), atol=1e-3)
    assert said in " ".join(notes)


def test_what_was_assumed_is_said_also_after_others_have_looked(tmp_path):
    """Checks of units and edges look at the first images before they are read."""
    log = Log().add("/i", START, info()).add("/d", START, ros_image(START, "cam_optical", FULL[6:42]))
    reader = open_log(log.write(tmp_path / "a.mcap"))
    assert reader.with_scales({}).frame_of("/d", *reader.sampled("/d", 1)) is not None
    list(reader.frames())
    assert len([note for note in reader.notes if "cropped" in note]) == 1


def test_halved(tmp_path):
    found, notes = points(FULL[::2, ::2], info(), tmp_path)
    assert "scaled to fit" in " ".join(notes)
    # the middle of two pixels is half a pixel away from the first of them
    np.testing.assert_allclose(found, expected(slice(0, 48, 2), slice(0, 64, 2)), atol=0.02)


def test_region_that_was_stated_and_done_or_not(tmp_path):
    region = info()
    region.roi.x_offset, region.roi.y_offset, region.roi.width, region.roi.height = 8, 4, 40, 30
    there = slice(4, 34), slice(8, 48)
    np.testing.assert_allclose(points(FULL[there], region, tmp_path)[0], expected(*there), atol=1e-3)
    found, notes = points(FULL, region, tmp_path)
    np.testing.assert_allclose(found, expected(slice(0, 48), slice(0, 64)), atol=1e-3)
    assert "region of interest" in " ".join(notes)
    found, notes = points(FULL, info(binning_x=2, binning_y=2), tmp_path)
    np.testing.assert_allclose(found, expected(slice(0, 48), slice(0, 64)), atol=1e-3)


@pytest.mark.parametrize(
    "cut, said",
    [
        (np.s_[::2], "rows or columns were left out"),
        (np.s_[:, 20:40], "at an unknown place"),
        (None, "rotated by 90 degrees"),
    ],
)
def test_what_nobody_can_know_is_asked(tmp_path, cut, said):
    with pytest.raises(LogError, match=f"{said}.*read.camera"):
        points(np.rot90(FULL).copy() if cut is None else FULL[cut], info(), tmp_path)
