"""TOML files written by hand: every value is checked, and errors name the line."""

import math
import re
import tomllib
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from voodoo_jax.config.limited import LARGEST, LEAST
from voodoo_jax.config.toml import nearest

LONGEST = 200  # characters of a name
MOST = 10_000  # tables of a kind: skeletons have some hundred joints

# kind of table, "" for the top of the file: (keys it must have, keys it may have)
Keys = Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]


class TomlFileError(ValueError):
    """A file that cannot be used: `path`, `line` (1-based, None for the file itself) and `reason`."""

    def __init__(self, path: str, line: int | None, reason: str):
        super().__init__(f"{path}:{line}: {reason}" if line else f"{path}: {reason}")
        self.path, self.line, self.reason = path, line, reason


class BodyFileError(TomlFileError):
    """A body file that does not describe a body: `path`, `line` (1-based, None for the file itself) and `reason`."""


class TomlFile:
    """TOML text with the line of every table and key, which tomllib does not give."""

    def __init__(self, text: str, source: str, keys: Keys, error: type[TomlFileError] = TomlFileError):
        self.source, self.keys, self.error = source, keys, error
        self.lines: dict[tuple[str, int, str | None], int] = {}  # (kind, number, key or "" for the header)
        try:
            self.data = tomllib.loads(text)
        except (ValueError, RecursionError) as fault:  # of its syntax, or numbers of thousands of digits
            where = re.search(r"\(at line (\d+),", str(fault))
            at_end = text.count("\n") + 1 if isinstance(fault, tomllib.TOMLDecodeError) else None
            line = int(where[1]) if where else at_end
            raise error(source, line, f"not TOML: {fault}") from fault
        kind, number, counts = "", 0, dict.fromkeys(keys, -1)
        for line, content in enumerate(text.splitlines(), 1):
            if header := re.match(r"\s*\[\[?\s*[\"']?([^\"'\]]*?)[\"']?\s*\]\]?\s*(#.*)?$", content):
                kind = header[1]
                counts[kind] = number = counts.get(kind, -1) + 1
                self.lines[kind, number, ""] = line
            elif key := re.match(r"\s*[\"']?([^\"'\s=#\[\],]+)[\"']?\s*=", content):
                self.lines.setdefault((kind, number if kind else 0, key[1]), line)

    def line(self, kind: str, number: int, key: str | None) -> int:
        # tables written inline have no header: then the line of the list that holds them
        tries = ((kind, number, key), (kind, number, ""), ("", 0, kind), ("", 0, key))
        return next((self.lines[t] for t in tries if t in self.lines), 1)

    def fail(self, key: str | None, reason: str, kind: str = "", number: int = 0) -> NoReturn:
        raise self.error(self.source, self.line(kind, number, key), reason)

    def root(self) -> "Table":
        return Table(self, "", 0, self.data)

    def tables(self, kind: str) -> list["Table"]:
        found = self.data.get(kind, [])
        if not isinstance(found, list) or not all(isinstance(t, dict) for t in found):
            self.fail("", f"'{kind}' must be written as [[{kind}]]", kind)
        if len(found) > MOST:
            self.fail("", f"there are {len(found)} of [[{kind}]], more than {MOST}", kind)
        return [Table(self, kind, i, t) for i, t in enumerate(found)]


class Table:
    """One table of a file: returns checked values, or raises an error with the line."""

    def __init__(self, file: TomlFile, kind: str, number: int, data: dict[str, Any]):
        self.file, self.kind, self.place, self.data = file, kind, number, data
        needed, allowed = file.keys[kind]
        for key in data:
            if key not in needed + allowed:
                self.fail(key, f"unknown key '{key}' in {self.title}{nearest(key, needed + allowed)}")
        for key in needed:
            if key not in data:
                self.fail("", f"{self.title} has no '{key}'")
        self.name = self.string("name")

    @property
    def title(self) -> str:
        name = self.data.get("name")
        return f"[[{self.kind}]]" + (f" '{name}'" if name else "") if self.kind else "the top of the file"

    def fail(self, key: str, reason: str) -> NoReturn:
        self.file.fail(key, reason, self.kind, self.place)

    def string(self, key: str, default: str = "") -> str:
        value = self.data.get(key, default)
        if not isinstance(value, str) or not value:
            self.fail(key, f"'{key}' of {self.title} must be a text in quotes, not {value!r}")
        if len(value) > LONGEST or not value.isprintable():
            self.fail(key, f"'{key}' of {self.title} must have at most {LONGEST} characters, all printable")
        return value

    def number(self, key: str, above: float, default: float | None = None) -> float:
        return float(self.numbers(key, 1, np.array([default]) if default is not None else None, above)[0])

    def numbers(self, key: str, count: int, default: np.ndarray | None = None, above: float = -math.inf) -> np.ndarray:
        if key not in self.data and default is not None:
            return default
        value = self.data[key]
        values = [value] if count == 1 else value
        if not isinstance(values, list) or len(values) != count or not all(type(v) in (int, float) for v in values):
            self.fail(key, f"'{key}' of {self.title} must be {count} number{'s' * (count > 1)}, not {value!r}")
        if any(v != v or v in (math.inf, -math.inf) for v in values):
            self.fail(key, f"'{key}' of {self.title} must be finite, not {value!r}")
        if min(values) <= above:
            self.fail(key, f"'{key}' of {self.title} must be {'above' if above >= 0 else 'at least'} 0, not {value!r}")
        if max(map(abs, values)) > LARGEST or above == 0 and min(values) < LEAST:
            least = f"at least {LEAST:g} and " if above == 0 else ""
            self.fail(key, f"'{key}' of {self.title} must be {least}at most {LARGEST:g}: the range of float32")
        return np.array(values, np.float64)

    def index(self, key: str, names: tuple[str, ...], what: str) -> int:
        name = self.string(key)
        if name not in names:
            self.fail(key, f"'{key}' of {self.title}: there is no {what} '{name}'{nearest(name, names)}")
        return names.index(name)

    def frame(self, key: str, z: np.ndarray, default_x: np.ndarray) -> Float[np.ndarray, "3 3"]:
        """Rotation matrix with the given z axis and an x axis as near as possible to that of the file."""
        x = self.numbers(key, 3, default=default_x)
        zn = float(np.linalg.norm(z))
        x = x - z * (x @ z) / zn**2 if zn > 1e-9 else 0 * x
        xn = float(np.linalg.norm(x))
        if xn < 1e-6:
            self.fail(key, f"{self.title}: the x axis is zero or points along the z axis, so the frame is not defined")
        return np.stack([x / xn, np.cross(z / zn, x / xn), z / zn], 1)


def unique_names(tables: list[Table]) -> tuple[str, ...]:
    """The names of tables of one kind; fails where two are equal."""
    seen: set[str] = set()
    for table in tables:
        if table.name in seen:
            table.fail("name", f"there are two of [[{table.kind}]] '{table.name}'")
        seen.add(table.name)
    return tuple(table.name for table in tables)
