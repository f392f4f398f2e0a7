"""Data from the user that a log lacks: calibrations from files, transforms as texts."""

import json
import os
import tomllib
from typing import Any

import numpy as np

from voodoo_jax.config.limited import PLACE, QUATERNION
from voodoo_jax.config.options import SettingsError
from voodoo_jax.io.transforms import Transform
from voodoo_jax.records.messages import Calibration, frame_name
from voodoo_jax.storage.troubles import small_text

# names of the same thing in camera_info messages, in files of camera_calibration, and in settings
_MATRICES = {
    "K": ("k", "K", "camera_matrix"),
    "D": ("d", "D", "distortion_coefficients"),
    "R": ("r", "R", "rectification_matrix"),
    "P": ("p", "P", "projection_matrix"),
}


def given_cameras(words: tuple[str, ...]) -> dict[str, Calibration]:
    """Calibrations by topic from texts such as /depth/image=camera.yaml; "" for one without a topic.

    Raises SettingsError for a file that cannot be read as a calibration.
    """
    found = {}
    for word in words:
        topic, _, place = word.rpartition("=")
        file = place if topic.startswith("/") else word
        try:
            found[topic if topic.startswith("/") else ""] = _calibration(file)
        except (ValueError, TypeError, AttributeError, OverflowError) as problem:
            if isinstance(problem, SettingsError):
                raise
            raise SettingsError(f"read.camera: '{file}' has no camera_info: {problem}") from problem
    return found


def given_transforms(words: tuple[str, ...]) -> list[Transform]:
    """Transforms from texts such as "base camera 0 0 1.2 0 0 0 1". Raises SettingsError."""
    found = []
    for word in words:
        parts = word.replace(",", " ").split()
        try:
            numbers = np.array([float(number) for number in parts[2:]])
        except ValueError:
            numbers = np.zeros(0)
        length = np.linalg.norm(numbers[3:]) if len(numbers) == 7 and (np.abs(numbers) < PLACE).all() else 0.0
        if not QUATERNION[0] <= length <= QUATERNION[1]:
            raise SettingsError(
                f"read.transform: '{word}' must look like 'parent child x y z qx qy qz qw', such as "
                "'base camera 0 0 1.2 0 0 0 1': metres and a quaternion, the pose of the child in the parent"
            )
        found.append(Transform(0, frame_name(parts[0]), frame_name(parts[1]), numbers[:3], numbers[3:]))
    return found


def _calibration(place: str) -> Calibration:
    content = _content(place)
    frame = frame_name(str((content.get("header") or {}).get("frame_id", "") or content.get("frame_id", "")))
    K = _numbers(content, "K", 9)
    if K is None:
        K = np.array([content.get(name, 0) for name in ("fx", "fy", "cx", "cy")], float)
        K = np.array([K[0], 0, K[2], 0, K[1], K[3], 0, 0, 1])
    K = K.reshape(3, 3)
    if not (0 < K[0, 0] < PLACE and 0 < K[1, 1] < PLACE and (np.abs(K) < PLACE).all()):
        raise SettingsError(f"read.camera: '{place}' has no focal length (K, camera_matrix, or fx, fy, cx, cy)")
    D, R, P = (_numbers(content, name, count) for name, count in (("D", 0), ("R", 9), ("P", 12)))
    width, height = (int(content.get(n, 0) or content.get(f"image_{n}", 0)) for n in ("width", "height"))
    model = str(content.get("distortion_model") or content.get("camera_model") or "plumb_bob")
    P = np.hstack([K, np.zeros((3, 1))]) if P is None else P.reshape(3, 4)
    D = np.zeros(0) if D is None else D
    R = np.eye(3) if R is None or not R.any() else R.reshape(3, 3)
    return Calibration(0, frame, width, height, model, D, K, P, R)


def _content(place: str) -> dict[str, Any]:
    try:
        text = small_text(os.path.expanduser(place))
    except (OSError, UnicodeDecodeError) as problem:
        raise SettingsError(
            f"read.camera: '{place}' cannot be read: {getattr(problem, 'strerror', None) or problem}"
        ) from problem
    try:
        if place.endswith(".toml"):
            content = tomllib.loads(text)
        elif place.endswith(".json"):
            content = json.loads(text)
        else:
            from ruamel.yaml import YAML  # takes a tenth of a second

            # `ros2 topic echo` writes a line of dashes behind each message
            content = next(iter(YAML(typ="safe", pure=True).load_all(text)), None)
    except Exception as problem:  # each parser has its own, RecursionError among them
        raise SettingsError(f"read.camera: '{place}' is not YAML, TOML or JSON: {problem}") from problem
    if not isinstance(content, dict):
        raise SettingsError(f"read.camera: '{place}' has no camera_info")
    return content


def _numbers(content: dict[str, Any], name: str, count: int) -> np.ndarray | None:
    for key in _MATRICES[name]:
        value = content.get(key)
        value = value.get("data") if isinstance(value, dict) else value
        if value is not None:
            try:
                numbers = np.array(value, float).ravel()
            except (TypeError, ValueError):
                numbers = np.zeros(0)
            if (count and len(numbers) != count) or not (np.abs(numbers) < PLACE).all():
                raise SettingsError(f"read.camera: {key} must be {count or 'a list of'} numbers")
            return numbers
    return None
