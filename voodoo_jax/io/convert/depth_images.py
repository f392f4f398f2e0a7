"""Converts folders of depth (16-bit PNG) and colour images, with a camera file or of the TUM RGB-D benchmark.

Camera file (TOML): width, height, fx, fy, cx, cy (pixels), unit (metres of one count, such as 0.001), and rate (images
per second) if the names of the images are not times in seconds. TUM: `depth.txt` and `rgb.txt` name the images and
their times, one count is 1/5000 m; the camera is that of the benchmark's registered images, unless a file gives another
one. Otherwise the images are in the folder itself, or in its folders `depth` and `rgb`, `color` or `colour`; colour is
used if it is registered to depth, pixel by pixel.
"""

import tomllib
from pathlib import Path

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from voodoo_jax.io.convert.target import ConvertError, Put, content, named_times, new_log, putter
from voodoo_jax.io.decode.image_codec import stored
from voodoo_jax.storage.guarded import Answer
from voodoo_jax.storage.troubles import small_text

IMAGE, INFO, FRAME = "/depth/image", "/depth/camera_info", "depth_optical"
COLOUR, COLOUR_INFO = "/color/image", "/color/camera_info"
COLOUR_FOLDERS, COLOUR_FILES = ("rgb", "color", "colour"), {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}
CAMERA_FILE = "camera.toml"
# the benchmark's page "intrinsic camera calibration": ROS default for registered images, factor 5000
TUM = {"width": 640, "height": 480, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5, "unit": 1 / 5000}
KEYS = ("width", "height", "fx", "fy", "cx", "cy", "unit")
MILLIMETRE = 0.001
LARGEST = 1e6  # of a camera's numbers: images have at most 65,535 pixels a side


def convert(source: Path, target: Answer, given: Path | None = None, rate: float = 0.0) -> list[str]:
    """Writes depth images in millimetres, and colour images as they are. Raises ConvertError, OSError."""
    listed = source / "depth.txt"
    camera = camera_file(given or source / CAMERA_FILE, TUM if listed.is_file() else None, given is not None)
    rate = rate or camera.get("rate", 0.0)
    folder = source / "depth" if (source / "depth").is_dir() else source
    images = _listed(listed) if listed.is_file() else named_times(folder, (".png",), rate)
    if not images:
        raise ConvertError(f"'{folder}' has no depth images (.png)")
    colours = _listed(source / "rgb.txt") if (source / "rgb.txt").is_file() else _beside(source, images, rate)
    notes, bad, rounded = [], 0, 0
    how = {True: cv2.IMREAD_UNCHANGED, False: cv2.IMREAD_COLOR}
    with new_log(target) as writer:
        put = putter(writer)
        for topic in (INFO, COLOUR_INFO) if colours else (INFO,):
            put(topic, images[0][0], pinhole(camera))
        for stamp, path, is_depth in sorted([*((*i, True) for i in images), *((*i, False) for i in colours)]):
            try:
                data = content(path, source)
                image = stored(data, "depth" if is_depth else "colour", how[is_depth])
            except (ValueError, OSError) as problem:
                notes.append(f"'{path.name}' was left out: {problem}")
                bad += is_depth
                continue
            if not is_depth:
                notes += _put_colour(put, stamp, path, camera, data, image)
                continue
            depth = image
            if depth.dtype != np.uint16 or depth.ndim != 2:
                notes.append(f"'{path.name}' was left out: it is not a 16-bit image of one channel")
                bad += 1
                continue
            if depth.shape != (camera["height"], camera["width"]):
                size = f"{depth.shape[1]} x {depth.shape[0]}"
                raise ConvertError(f"'{path}' is {size}, the camera {camera['width']} x {camera['height']}")
            put(IMAGE, stamp, depth_image(depth, camera["unit"]))
            rounded += camera["unit"] != MILLIMETRE
        if bad == len(images):
            raise ConvertError(f"'{source}': no image could be read; {notes[0]}")
    if rounded:
        notes.append(f"counts of {1000 * camera['unit']:g} mm became metres in 32 bits")
    return notes


def _beside(source: Path, depth: list[tuple[int, Path]], rate: float) -> list[tuple[int, Path]]:
    """Colour images in a folder of their own, with stamps: those of the depth images with the same names, if any."""
    for folder in (source / name for name in COLOUR_FOLDERS):
        if folder.is_dir():
            stamps = {path.stem: stamp for stamp, path in depth}
            files = sorted(path for path in folder.iterdir() if path.suffix.lower() in COLOUR_FILES)
            alike = [(stamps[path.stem], path) for path in files if path.stem in stamps]
            return alike or named_times(folder, tuple(COLOUR_FILES), rate)
    return []


# 6 parameters: the image, as its file has it and unpacked
def _put_colour(put: Put, stamp: int, path: Path, camera: dict, data: bytes, image: np.ndarray) -> list[str]:
    """Writes a colour image as it is; what was wrong with it."""
    size, kind = (int(camera["height"]), int(camera["width"])), COLOUR_FILES.get(path.suffix.lower())
    if kind is None:
        return [f"'{path.name}' was left out: colour images end in {', '.join(COLOUR_FILES)}"]
    if image.shape[:2] != size:
        own, wanted = (f"{columns} x {rows}" for rows, columns in (image.shape[:2], size))
        return [f"'{path.name}' was left out: it is {own}, and so not registered to depth, which is {wanted}"]
    put(COLOUR, stamp, CompressedImage(frame_id=FRAME, format=kind, data=data))
    return []


def camera_file(path: Path, usual: dict | None = None, asked: bool = True) -> dict:
    """The contents of a camera file; `usual` if none was given. Raises ConvertError."""
    if not path.is_file():
        if usual is None or asked:
            raise ConvertError(
                f"there is no camera file '{path}': depth images need one (TOML) with {', '.join(KEYS)} and, where the "
                "images' names are not times, rate"
            )
        return dict(usual)
    try:
        found = (usual or {}) | tomllib.loads(small_text(path))
    except (ValueError, RecursionError, OSError) as problem:
        raise ConvertError(f"'{path}' is not a TOML file: {problem}") from problem
    for key in KEYS:
        if not isinstance(found.get(key), int | float) or not 0 < found[key] <= LARGEST:
            raise ConvertError(f"'{path}': '{key}' must be a number above 0, and at most {LARGEST:g}")
    return found


def _listed(path: Path) -> list[tuple[int, Path]]:
    try:
        rows = [line.split() for line in small_text(path, inside=path.parent).splitlines() if line.strip()]
        return sorted((round(float(row[0]) * 1e9), path.parent / row[1]) for row in rows if not row[0].startswith("#"))
    except (ValueError, IndexError, OverflowError, OSError) as problem:
        raise ConvertError(f"'{path}': a line must be a time in seconds and a file") from problem


def pinhole(camera: dict) -> CameraCalibration:
    """The calibration of a camera file."""
    fx, fy, cx, cy = (float(camera[key]) for key in ("fx", "fy", "cx", "cy"))
    return CameraCalibration(
        frame_id=FRAME, width=int(camera["width"]), height=int(camera["height"]), distortion_model="plumb_bob",
        D=[0.0] * 5, K=[fx, 0, cx, 0, fy, cy, 0, 0, 1], R=np.eye(3).ravel().tolist(),
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )  # fmt: skip


def depth_image(depth: np.ndarray, unit: float) -> RawImage:
    """The image, unchanged if counts are millimetres, else in metres."""
    whole = unit == MILLIMETRE
    data = depth.astype("<u2") if whole else (depth * np.float64(unit)).astype("<f4")
    return RawImage(
        frame_id=FRAME, width=depth.shape[1], height=depth.shape[0], encoding="16UC1" if whole else "32FC1",
        step=data.strides[0], data=data.tobytes(),
    )  # fmt: skip
