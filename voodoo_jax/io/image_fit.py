"""Adapts a calibration to images of another size: scaled, cropped, a region of interest, binning."""

from dataclasses import replace

import numpy as np

from voodoo_jax.records.messages import Calibration

ALIKE = 0.02  # of each other: rounding to whole pixels, as 424 x 240 from 1280 x 720, changes factors by no more
PARTS = (2, 3, 4)  # every second, third or fourth row is kept: as likely as a crop to so little
CROPPED = "assumed to be cropped about its centre (if not, give its calibration by read.camera)"
LEAST = 0.4  # of the picture: who crops to less has chosen a place, not the middle


def fitted(c: Calibration, shape: tuple[int, int]) -> tuple[Calibration, str]:
    """The calibration for images of this size, and the assumption as half a sentence; "" if none.

    Pixels stay square: if the two directions do not shrink alike, the image was cropped, about its centre. Raises
    ValueError if the change is ambiguous.
    """
    rows, columns = shape
    if not (c.width and c.height) or (c.height, c.width) == shape:
        return replace(c, width=columns, height=rows), ""
    for other in c.others:  # a region or binning that was stated, and not done
        if (other.height, other.width) == shape:
            return other, "its region of interest or binning does not fit the image, and is ignored"
    across, down = columns / c.width, rows / c.height
    if abs(across / down - 1) <= ALIKE:
        return scaled(c, shape), "scaled to fit"
    sizes = f"it is {columns} x {rows} pixels, its calibration is of {c.width} x {c.height}"
    ask = "give the right calibration by read.camera"
    if abs(columns / c.height / (rows / c.width) - 1) <= ALIKE:
        raise ValueError(f"{sizes}: the image was rotated by 90 degrees; {ask}")
    less = min(across, down) / max(across, down)
    if any(abs(less * part - 1) < 1e-6 for part in PARTS):
        raise ValueError(f"{sizes}: it was cropped, or rows or columns were left out; {ask}")
    if less < LEAST:
        raise ValueError(f"{sizes}: it was cropped, at an unknown place; {ask}")
    size = _uncropped(c, shape)
    whole = moved(scaled(c, size), ((columns - size[1]) / 2, (rows - size[0]) / 2))
    return replace(whole, width=columns, height=rows), CROPPED


def _uncropped(c: Calibration, shape: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of the image before it was cropped to `shape`."""
    factor = max(shape[1] / c.width, shape[0] / c.height)
    return round(c.height * factor), round(c.width * factor)


def leeway(c: Calibration, shape: tuple[int, int]) -> tuple[float, float]:
    """Largest offset (pixels across and down) of the centre of an image that `fitted` assumes to be cropped from that
    of the whole image; 0, 0 for others."""
    if fitted(c, shape)[1] != CROPPED:
        return 0.0, 0.0
    rows, columns = _uncropped(c, shape)
    return (columns - shape[1]) / 2, (rows - shape[0]) / 2


def moved(c: Calibration, by: tuple[float, float]) -> Calibration:
    """The calibration with its principal point moved by pixels to the right and down."""
    K, P = c.K.copy(), c.P.copy()
    for matrix in (K, P):
        matrix[:2, 2] += np.array(by) * matrix[2, 2]
    return replace(c, K=K, P=P)


def scaled(c: Calibration, shape: tuple[int, int]) -> Calibration:
    """The calibration for images of another size (rows, columns) that show the same."""
    rows, columns = shape
    if not (c.width and c.height) or (c.height, c.width) == shape:
        return replace(c, width=columns, height=rows)
    scale = np.array([columns / c.width, rows / c.height])
    K, P = c.K.copy(), c.P.copy()
    for matrix in (K, P):
        matrix[:2] *= scale[:, None]
        matrix[:2, 2] += 0.5 * scale - 0.5
    return replace(c, width=columns, height=rows, K=K, P=P)
