"""Key points of a person in an image by a network: BlazePose (Bazarevsky and others 2020, arXiv:2006.10204).

Runs the two networks that come with MediaPipe, a detector and one for 33 key points, by LiteRT. MediaPipe itself is
not imported: its package is where the files are. What is done before and after the networks, and all its numbers, are
those of MediaPipe's graphs `pose_detection_cpu` and `pose_landmark_by_roi_cpu`.
"""

import zipfile
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, UInt8

from voodoo_jax.config.options import SettingsError

KEY_POINTS = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb",
    "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel",
    "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
FILES = ("pose_detection/pose_detection.tflite", "pose_landmark/pose_landmark_full.tflite")
_FOLDER = "mediapipe/modules"  # of the files in MediaPipe's package
# what MediaPipe's networks take and give, and the numbers of its graphs and calculators around them
_DETECTOR, _SIZE, _HEATMAP = 224, 256, 64  # MediaPipe: pixels of the inputs of both networks, and of heat maps
_ALL = 39  # MediaPipe: the 33 key points, two that say where to look next, and four that nobody uses
_STRIDES = ((8, 2), (16, 2), (32, 6))  # MediaPipe, SsdAnchorsCalculator: pixels, anchors in each place
_SURE = 0.5  # a person is there: MediaPipe's min_detection_confidence, and its threshold of the pose flag
_SAME = 0.3  # overlap of detections of one person: MediaPipe, NonMaxSuppressionCalculator
_LARGER = 1.25  # margin around the circle through hips and the farthest point: MediaPipe, pose_detection_to_roi
_KERNEL, _PEAK = 3, 0.5  # pixels each way, least peak of a heat map: MediaPipe, RefineLandmarksFromHeatmapCalculator
NO_RUNTIME = "read.pose_net: LiteRT, which runs the networks, is not installed: pip install 'voodoo_jax[pose]'."
_PIECE = 64 * 2**20  # bytes: larger files are none of MediaPipe's networks (full has 6 MB, heavy 28 MB)


@dataclass(frozen=True)
class Region:
    """A square of an image, turned so that the person in it stands upright."""

    centre: Float[np.ndarray, "2"]  # pixels; the first one is 0, 0
    size: float  # of a side, pixels
    angle: float  # radians, from the image's upright to the person's, clockwise

    @property
    def to_image(self) -> Float[np.ndarray, "2 3"]:
        """From coordinates in the square, 0 to 1, to the image."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        turn = self.size * np.array([[c, -s], [s, c]])
        return np.column_stack([turn, self.centre - turn @ [0.5, 0.5]])


@dataclass(frozen=True)
class KeyPoints:
    """Key points of one person in one image; rows as in KEY_POINTS."""

    pixels: Float[np.ndarray, "33 2"]  # u right, v down; the centre of the first pixel is 0, 0
    scores: Float[np.ndarray, " 33"]  # 0 to 1: how sure the network is that the point is in the image and not hidden


class PoseNet:
    """Finds the key points of the most visible person, image by image; skips the detector if the person was in the last
    image. One for each camera."""

    def __init__(self, files: tuple[bytes, bytes]):
        """`files` as `pose_files` gives them. Raises SettingsError."""
        self._detector, self._landmarks = (_interpreter(data) for data in files)
        self._region: Region | None = None

    def find(self, image: UInt8[np.ndarray, "row column 3"]) -> KeyPoints | None:
        """Key points in an image (blue, green, red); None without a person."""
        region, fresh = self._region, self._region is None
        if region is None:
            region = self._detect(image)
        found = None if region is None else self._look(image, region)
        if found is None and not fresh:  # gone from where the person was
            region = self._detect(image)
            found = None if region is None else self._look(image, region)
        if found is None:
            self._region = None
            return None
        pixels, scores, self._region = found
        return KeyPoints(pixels, scores)

    def _detect(self, image: np.ndarray) -> Region | None:
        rows, columns = image.shape[:2]
        whole = Region(np.array([columns, rows]) / 2.0, float(max(rows, columns)), 0.0)
        n = len(anchors())
        boxes, scores = _run(self._detector, cropped(image, whole, _DETECTOR) * 2 - 1, ((1, n, 12), (1, n, 1)))
        points = best_detection(boxes, scores[:, 0])
        return None if points is None else around(*(_moved(points[2:4], whole)))

    def _look(self, image: np.ndarray, region: Region) -> tuple[np.ndarray, np.ndarray, Region] | None:
        shapes = (1, 5 * _ALL), (1, 1), (1, _HEATMAP, _HEATMAP, _ALL)
        raw, flag, maps = _run(self._landmarks, cropped(image, region, _SIZE), shapes)
        if flag[0] < _SURE:
            return None
        raw = raw.reshape(_ALL, 5)
        places = refined(raw[:, :2] / _SIZE, maps)
        pixels, scores = _moved(places, region), _sigmoid(raw[:33, 3:]).prod(1)
        return pixels[:33], scores, around(pixels[33], pixels[34])


def check_pose_net(place: str) -> None:
    """Raises SettingsError if `pose_files` does, or if LiteRT is not installed."""
    pose_files(place)
    if find_spec("ai_edge_litert") is None:
        raise SettingsError(NO_RUNTIME)


def pose_files(place: str) -> tuple[bytes, bytes]:
    """Both networks: `place` is "mediapipe" (the installed package, of that or another name, with a folder mediapipe),
    a wheel of it, or a folder with both files in it or below. Raises SettingsError."""
    if place != "mediapipe":
        return _files_in(Path(place).expanduser())
    found = find_spec("mediapipe")  # finds it, imports nothing
    for folder in (found.submodule_search_locations or ()) if found is not None else ():
        here = [Path(folder) / "modules" / name for name in FILES]
        if all(file.is_file() for file in here):
            return _read(here[0]), _read(here[1])
    state = "is not installed" if found is None else "is installed, but its networks are not in it"
    raise SettingsError(
        f"read.pose_net: MediaPipe {state}. The extra [pose] installs a release that has them; or give a wheel of "
        "MediaPipe 0.10.21 (pip download --no-deps mediapipe==0.10.21) or a folder with pose_detection.tflite and "
        "pose_landmark_full.tflite."
    )


def _files_in(place: Path) -> tuple[bytes, bytes]:
    if not place.exists():
        raise SettingsError(f"read.pose_net: there is no '{place}'.")
    try:
        if place.is_dir():
            found = [sorted(place.rglob(Path(name).name))[:1] for name in FILES]
            if all(found):
                return _read(found[0][0]), _read(found[1][0])
        else:
            with zipfile.ZipFile(place) as wheel:
                inside = [wheel.getinfo(f"{_FOLDER}/{name}") for name in FILES]
                if max(info.file_size for info in inside) <= _PIECE:
                    return wheel.read(inside[0]), wheel.read(inside[1])
    except (OSError, KeyError, zipfile.BadZipFile) as problem:
        raise SettingsError(f"read.pose_net: '{place}' has no networks of MediaPipe ({problem}).") from problem
    raise SettingsError(f"read.pose_net: '{place}' does not have {' and '.join(Path(name).name for name in FILES)}.")


def _read(file: Path) -> bytes:
    if file.stat().st_size > _PIECE:
        raise SettingsError(f"read.pose_net: '{file}' is too large for a network of MediaPipe.")
    return file.read_bytes()


def cropped(image: UInt8[np.ndarray, "row column 3"], region: Region, size: int) -> Float32[np.ndarray, "size size 3"]:
    """A region of an image (blue, green, red) as input of the networks: red, green, blue, 0 to 1; black outside."""
    import cv2  # here, for who reads logs without a network need not wait for it

    # the networks know pixels by their numbers, as MediaPipe cuts them out: without halves for the centres
    step = region.to_image
    matrix = np.column_stack([step[:, :2] / size, step[:, 2]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    square = cv2.warpAffine(image, matrix, (size, size), flags=flags, borderMode=cv2.BORDER_CONSTANT)
    return np.ascontiguousarray(np.asarray(square)[..., ::-1], np.float32) / 255


@cache
def anchors() -> Float[np.ndarray, "anchor 2"]:
    """Centres of the detector's anchors, 0 to 1."""
    parts = []
    for stride, each in _STRIDES:
        n = _DETECTOR // stride
        v, u = (np.mgrid[:n, :n] + 0.5) / n
        parts.append(np.repeat(np.column_stack([u.ravel(), v.ravel()]), each, axis=0))
    return np.concatenate(parts)


def best_detection(raw: Float[np.ndarray, "anchor 12"], logits: Float[np.ndarray, " anchor"]) -> np.ndarray | None:
    """Corners of the face's box and the four key points [6, 2] of the person with the highest score, 0 to 1 in the
    detector's square: the mean of all detections of that person, weighted by score. None without a person."""
    scores = _sigmoid(np.clip(logits, -100, 100))
    sure = np.flatnonzero(scores >= _SURE)
    if not len(sure):
        return None
    scores, places = scores[sure], raw[sure].reshape(-1, 6, 2) / _DETECTOR
    centre, half = places[:, 0] + anchors()[sure], places[:, 1] / 2
    points = places + anchors()[sure, None]
    points[:, 0], points[:, 1] = centre - half, centre + half
    best = points[np.argmax(scores)]
    low, high = np.maximum(points[:, 0], best[0]), np.minimum(points[:, 1], best[1])
    both, area = np.clip(high - low, 0, None).prod(1), (points[:, 1] - points[:, 0]).prod(1)
    same = both > _SAME * (area + (best[1] - best[0]).prod() - both)
    same[np.argmax(scores)] = True
    return np.average(points[same], axis=0, weights=scores[same])


def around(hips: Float[np.ndarray, "2"], far: Float[np.ndarray, "2"]) -> Region:
    """The square around a person, from the middle of the hips (pixels) and the point straight above it on the circle
    around the person."""
    up = far - hips
    return Region(hips, 2 * _LARGER * float(np.hypot(*up)), float(np.arctan2(up[0], -up[1])))


def refined(places: Float[np.ndarray, "point 2"], maps: Float[np.ndarray, "row column point"]) -> np.ndarray:
    """Key points, 0 to 1 in their square, moved to the local mean of their heat maps (logits) where these are
    certain."""
    out, size = places.copy(), maps.shape[0]
    for k, (u, v) in enumerate((places * size).astype(int).tolist()):
        if not (0 <= u < size and 0 <= v < size):
            continue
        v0, u0 = max(0, v - _KERNEL), max(0, u - _KERNEL)
        heat = _sigmoid(maps[v0 : v + _KERNEL + 1, u0 : u + _KERNEL + 1, k].astype(float))
        if heat.max() >= _PEAK:
            rows, columns = heat.sum(1), heat.sum(0)
            out[k] = columns @ (u0 + np.arange(len(columns))), rows @ (v0 + np.arange(len(rows)))
            out[k] /= heat.sum() * size
    return out


def _moved(points: np.ndarray, region: Region) -> np.ndarray:
    """From coordinates in a region's square, 0 to 1, to pixels of the image."""
    step = region.to_image
    return points @ step[:, :2].T + step[:, 2]


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(np.asarray(x, float), -100, 100)))


def _interpreter(data: bytes) -> Any:
    try:
        from ai_edge_litert.interpreter import Interpreter  # pyright: ignore[reportMissingImports]
    except ImportError as problem:
        raise SettingsError(NO_RUNTIME) from problem
    try:
        made = Interpreter(model_content=data, num_threads=1)  # logs share the cores among them
        made.allocate_tensors()
    except (ValueError, RuntimeError) as problem:
        raise SettingsError(f"read.pose_net: a network cannot be loaded ({problem}).") from problem
    return made


def _run(net: Any, image: Float32[np.ndarray, "row column 3"], shapes: tuple[tuple[int, ...], ...]) -> list[np.ndarray]:
    """Outputs of a network for an image, of these shapes. Raises SettingsError for another network."""
    takes, gives = net.get_input_details(), {tuple(o["shape"].tolist()): o["index"] for o in net.get_output_details()}
    if takes[0]["shape"].tolist() != [1, *image.shape] or not set(shapes) <= gives.keys():
        raise SettingsError(
            "read.pose_net: these are not BlazePose's networks: their inputs and outputs have other shapes."
        )
    net.set_tensor(takes[0]["index"], image[None])
    net.invoke()
    return [net.get_tensor(gives[shape])[0] for shape in shapes]
