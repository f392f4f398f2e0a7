"""Text of a body file, table by table, from lengths in metres."""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, "3"]


class TextOfBody:
    """Lines of a body file; places are relative to `origin`, that of the body frame."""

    def __init__(self, scale: float, origin: Vector):
        self._scale, self._origin, self._lines = scale, origin, list[str]()

    def text(self) -> str:
        """All of it."""
        return "\n".join(self._lines) + "\n"

    def head(self, name: str, scale_name: str) -> None:
        """Lines before all tables."""
        self._lines += [f"name = {string_text(name)}", f"scale = {number_text(self._scale)}"]
        self._lines += [f"scale_name = {string_text(scale_name)}"]

    # 6 parameters: those of a limb in the file
    def limb(self, name: str, bottom: Vector, top: Vector, x_axis: Vector, bottom_axes, top_axes) -> None:
        """A limb between two points, with the semi-axes of its ends."""
        self._lines += ["", "[[limb]]", f"name = {string_text(name)}", f"bottom = {self._place(bottom)}"]
        self._lines += [f"top = {self._place(top)}", f"x_axis = {numbers_text(x_axis)}"]
        self._lines += [f"bottom_axes = {self._lengths(bottom_axes)}", f"top_axes = {self._lengths(top_axes)}"]

    def joint(self, name: str, parent: str, child: str, **values: Any) -> None:
        """A joint; `values` by the file's keys, in its order: at, child_at (places), axes (lengths), x_axis, z_axis,
        child_x_axis, child_z_axis (directions), swing_x, swing_y, twist (degrees), weight (a number)."""
        self._lines += ["", "[[joint]]", f"name = {string_text(name)}", f"parent = {string_text(parent)}"]
        self._lines += [f"child = {string_text(child)}"]
        for key, value in values.items():
            text = self._place if key.endswith("at") else self._lengths if key == "axes" else numbers_text
            self._lines += [f"{key} = {text(value) if np.ndim(value) else number_text(value)}"]

    def point(self, kind: str, name: str, limb: str, at: Vector) -> None:
        """A `centre`, which tracks report, or a `site`, a feature point."""
        self._lines += ["", f"[[{kind}]]", f"name = {string_text(name)}", f"limb = {string_text(limb)}"]
        self._lines += [f"at = {self._place(at)}"]

    def segment(self, name: str, start: str, end: str) -> None:
        """A length that is reported."""
        self._lines += ["", "[[segment]]", f"name = {string_text(name)}", f"from = {string_text(start)}"]
        self._lines += [f"to = {string_text(end)}"]

    def mode(self, name: str, changes: Iterable[tuple[str, float]]) -> None:
        """A variation among bodies of one scale."""
        table = ", ".join(f"{string_text(key)} = {number_text(value)}" for key, value in changes)
        self._lines += ["", "[[mode]]", f"name = {string_text(name)}", f"changes = {{ {table} }}"]

    def _place(self, at: np.ndarray) -> str:
        return numbers_text((np.asarray(at, float) - self._origin) / self._scale)

    def _lengths(self, values: np.ndarray) -> str:
        return numbers_text(np.asarray(values, float) / self._scale)


def number_text(value: float) -> str:
    """A number as body files have it."""
    text = f"{float(value) + 0.0:.9g}"  # + 0.0: no minus zero
    return text if any(c in text for c in ".e") else text + ".0"


def numbers_text(values: np.ndarray) -> str:
    """Numbers as body files have them."""
    return "[" + ", ".join(number_text(v) for v in np.round(values, 9) + 0.0) + "]"


def string_text(text: str) -> str:
    """A text as body files have it."""
    return json.dumps(text, ensure_ascii=False)
