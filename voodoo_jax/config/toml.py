"""Settings from and to TOML; what is wrong in a settings file, where, and what would be right."""

import ast
import inspect
import json
import os
import textwrap
import tomllib
from collections.abc import Iterable
from dataclasses import Field, fields, is_dataclass, replace
from difflib import get_close_matches
from math import hypot
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from voodoo_jax.config.limited import LARGEST, LEAST, SIZES
from voodoo_jax.config.options import Change, LimitSettings, Settings, SettingsError
from voodoo_jax.storage.troubles import small_text

MOST = 2**31 - 1  # of what is counted: 32 bits


def _check(stage: str, f: Field, value: Any) -> Any:
    """The value as the field wants it, or SettingsError."""
    name, default = f"{stage}.{f.name}".lstrip("."), getattr(_STAGES[stage](), f.name)
    if get_origin(f.type) is Literal:
        if value not in get_args(f.type):
            raise SettingsError(f"{name} = {value!r}: must be one of {', '.join(map(repr, get_args(f.type)))}")
        return value
    if isinstance(default, tuple):
        if default and isinstance(default[0], float):
            good = isinstance(value, list) and all(type(v) in (int, float) and 0 <= v <= LARGEST for v in value)
            if not good:
                raise SettingsError(
                    f"{name} = {value!r}: must be a list of numbers that are not negative, and at most {LARGEST:g}"
                )
            if name == "flexible.depth_noise" and len(value) != 3:
                raise SettingsError(f"{name} = {value!r}: must be three numbers: of roots, middles and ends of limbs")
            return tuple(float(v) for v in value)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise SettingsError(f"{name} = {value!r}: must be a list of texts")
        if name in _PAIRS:
            check_pairs(name, tuple(value))
        return tuple(value)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value) if abs(value) <= LARGEST else float("inf")  # some are too large for that, too
    if name == "read.up" and value:
        direction(str(value))
    if type(value) is not type(default):
        raise SettingsError(f"{name} = {value!r}: must be {_WORDS[type(default)]}, such as {default!r}")
    if name == "start.scale" and 0 < value < SIZES[0]:
        raise SettingsError(f"{name} = {value!r}: must be at least {SIZES[0]} (metres), or 0: it is measured")
    if isinstance(value, (int, float)) and not isinstance(value, bool) and not value >= 0:
        raise SettingsError(f"{name} = {value!r}: must not be negative")
    low, high = _BOUNDS.get(name, (0, LARGEST if isinstance(value, float) else MOST))
    high = float("inf") if name in _ENDLESS else high
    if isinstance(value, (int, float)) and not low <= value <= high:
        raise SettingsError(f"{name} = {value!r}: must be at least {low} and at most {high:.12g}")
    return value


def check_pairs(name: str, words: tuple[str, ...]) -> dict[str, str]:
    """Words like "face=10" of an option as a dictionary. Raises SettingsError."""
    numbers, example = _PAIRS[name]
    for word in words:
        key, _, value = word.partition("=")
        try:
            low, high = _PAIR_BOUNDS.get(name, (0, LARGEST))
            good = bool(key and value) and (not numbers or low <= float(value) <= high)
            if name == "read.labels":
                int(key)
            if name == "read.mirror" and value not in ("x", "y", "z", "none"):
                good = False
            if name == "read.radial" and value not in ("yes", "no"):
                good = False
        except ValueError:
            good = False
        if not good:
            raise SettingsError(f"{name}: '{word}' must look like {example}")
    return dict(word.split("=", 1) for word in words)


def direction(word: str) -> tuple[float, float, float]:
    """Unit vector of a text such as z, -y or 0,0.1,1. Raises SettingsError."""
    axis = word.strip().lower().removeprefix("+")
    sign = -1.0 if axis.startswith("-") else 1.0
    if (name := axis.removeprefix("-")) in ("x", "y", "z"):
        return (sign * (name == "x"), sign * (name == "y"), sign * (name == "z"))
    try:
        x, y, z = (float(number) for number in axis.split(","))
        length = hypot(x, y, z)
        if 0 < length < float("inf"):
            return (x / length, y / length, z / length)
    except ValueError:
        pass
    raise SettingsError(f"read.up = '{word}': must be x, y, z, -x, -y, -z or three numbers such as 0,0.1,1")


def read_settings(path: str | os.PathLike[str], base: "Settings | None" = None) -> "Settings":
    """Settings from a TOML file with a table per stage; what it does not name stays as in `base`. Raises SettingsError,
    OSError."""
    base = base or Settings()
    try:
        content = tomllib.loads(small_text(path))
    except (ValueError, RecursionError) as problem:  # of its syntax, its bytes, or numbers of thousands of digits
        raise SettingsError(f"{path}: not a TOML file: {problem}") from problem
    try:
        return settings_from(content, base, path)
    except SettingsError as problem:
        raise problem if str(problem).startswith(f"{path}") else SettingsError(f"{path}: {problem}") from None


def settings_from(content: dict[str, Any], base: "Settings", path: str | os.PathLike[str]) -> "Settings":
    """Settings from the content of a TOML file, see read_settings; `path` is named in errors, and bodies of changes are
    looked for beside it. Raises SettingsError."""
    stages: dict[str, Any] = {}
    changes = base.changes
    for stage, values in content.items():
        if stage in _OF_ALL:
            stages[stage] = _check("", _OF_ALL[stage], values)
            continue
        if stage == "change":
            if not isinstance(values, list) or not all(isinstance(table, dict) for table in values):
                raise SettingsError(f"{path}: changes are tables [[change]], with two brackets")
            changes = tuple(_change(path, n, table) for n, table in enumerate(values, 1))
            continue
        if stage not in _STAGES or not isinstance(values, dict):
            raise SettingsError(f"{path}: [{stage}] is not a section{nearest(stage, filter(None, _STAGES))}")
        known = {f.name: f for f in fields(_STAGES[stage])}
        checked = {}
        for name, value in values.items():
            if name not in known:
                raise SettingsError(f"{path}: [{stage}] has no option '{name}'{nearest(name, known)}")
            checked[name] = _check(stage, known[name], value)
        stages[stage] = replace(getattr(base, stage), **checked)
    return replace(base, **stages, changes=changes)


def nearest(name: str, names: Iterable[str]) -> str:
    """The end of a sentence about an unknown name."""
    names = list(names)
    close = get_close_matches(name, names, 1)
    return f"; did you mean '{close[0]}'?" if close else f"; there are {', '.join(names)}" if names else ""


def _change(path: str | os.PathLike[str], number: int, table: dict[str, Any]) -> Change:
    """One table [[change]]. A body file in it is looked for beside the settings file."""
    where = f"{path}: [[change]] number {number}"
    known = {f.name: getattr(Change(0.0), f.name) for f in fields(Change)}
    if "time" not in table:
        raise SettingsError(f"{where} has no 'time', the seconds after the first frame")
    values: dict[str, Any] = {}
    for name, value in table.items():
        if name not in known:
            raise SettingsError(f"{where} has no option '{name}'{nearest(name, known)}")
        if name == "sizes":
            good = isinstance(value, dict) and all(_numbers(v, 5, above=LEAST) for v in value.values())
            wanted = "a table such as { l_forearm = [0.04, 0.04, 0.03, 0.03, 0.25] }"
            value = tuple((limb, tuple(map(float, v))) for limb, v in value.items()) if good else value
        elif name == "remove":
            value = [value] if isinstance(value, str) else value
            good, wanted = isinstance(value, list) and all(isinstance(v, str) for v in value), "names of limbs"
            value = tuple(value) if good else value
        elif isinstance(known[name], str):
            good, wanted = isinstance(value, str), "a text"
        elif isinstance(known[name], float):
            least = SIZES[0] if name == "scale" and value != 0 else -1e-300
            good = _numbers([value], 1, above=least)
            wanted = f"a number above {least}" if least > 0 else f"a number that is not negative, below {LARGEST:g}"
        else:
            count = 2 if name == "joint_axes" else 3
            good, wanted = _numbers(value, count), f"{count} numbers"
            value = tuple(map(float, value)) if good else value
        if not good:
            raise SettingsError(f"{where}: {name} = {value!r} must be {wanted}")
        values[name] = value
    if str(values.get("add", "")).endswith(".toml"):
        values["add"] = str(Path(path).parent / values["add"])
    return Change(**values)


def _numbers(value: Any, count: int, above: float = -float("inf")) -> bool:
    return (
        isinstance(value, list)
        and len(value) == count
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) and above < v < LARGEST for v in value)
    )


def check_settings(settings: "Settings") -> None:
    """Raises SettingsError for a value that a settings file could not have: flags and Python reach here unchecked."""
    for stage in _STAGES:
        for f, value in _values(settings, stage):
            _check(stage, f, list(value) if isinstance(value, tuple) else value)


def _values(settings: "Settings", stage: str) -> list[tuple[Field, Any]]:
    """The options of a stage, and their values."""
    if not stage:
        return [(f, getattr(settings, f.name)) for f in _OF_ALL.values()]
    return [(f, getattr(getattr(settings, stage), f.name)) for f in fields(_STAGES[stage])]


def help_texts(cls: type) -> dict[str, str]:
    """The text under each field of a settings class."""
    node = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]
    assert isinstance(node, ast.ClassDef)
    texts = {}
    for item, below in zip(node.body, node.body[1:]):
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name) and isinstance(below, ast.Expr):
            texts[item.target.id] = " ".join(str(ast.literal_eval(below.value)).split())
    return texts


def settings_text(settings: "Settings | None" = None) -> str:
    """Settings as a TOML file with every option's meaning as a comment."""
    settings = settings or Settings()
    lines = ["# Settings of voodoo-jax. Use: voodoo-jax replay LOG... --out DIR --config THIS_FILE"]
    for stage, cls in _STAGES.items():
        texts = help_texts(cls)
        lines += ["", f"# {cls.__doc__}", f"[{stage}]"] if stage else [""]
        for f, value in _values(settings, stage):
            written = json.dumps(list(value)) if isinstance(value, tuple) else json.dumps(value)
            written = {"Infinity": "inf"}.get(written, written)
            choices = f" ({', '.join(get_args(f.type))})" if get_origin(f.type) is Literal else ""
            lines += [f"# {texts[f.name]}{choices}", f"{f.name} = {written}"]
    texts = help_texts(Change)
    lines += ["", f"# {Change.__doc__}", "# [[change]]"]
    for f in fields(Change):
        lines += [f"# {f.name}: {texts[f.name]}"]
    for change in settings.changes:
        lines += ["", "[[change]]"]
        for f in fields(Change):
            value = getattr(change, f.name)
            if f.name == "time" or value != f.default:
                sizes = ", ".join(f"{limb} = {list(v)}" for limb, v in value) if f.name == "sizes" else ""
                listed = list(value) if isinstance(value, tuple) else value
                lines += [f"{f.name} = " + (f"{{ {sizes} }}" if sizes else json.dumps(listed))]
    return "\n".join(lines) + "\n"


# by the names of their tables; "": what stands before all tables
_STAGES: dict[str, Any] = {"": Settings} | {f.name: f.type for f in fields(Settings) if is_dataclass(f.type)}
_OF_ALL = {f.name: f for f in fields(Settings) if f.name not in (*_STAGES, "changes")}
# texts like "face=10": whether a number stands behind the equals sign, and what they look like
_PAIRS = {
    "features.names": (False, "name=point, such as face=sellion"),
    "features.weights": (True, "name=number, such as face=10"),
    "read.parts": (False, "topic=part, such as /people/points=body or /hands/left=l_forearm"),
    "read.labels": (False, "number=part, such as 3=head, 7=body or 0=free"),
    "read.weights": (True, "topic=number, such as /stereo/points=0.5"),
    "read.scale": (True, "topic=metres per unit, such as /camera/depth=0.001"),
    "read.delays": (True, "topic=seconds, such as /lidar/points=0.25"),
    "read.mirror": (False, "topic=axis (x, y, z or none), such as /markers=z"),
    "read.radial": (False, "topic=yes or no, such as /tof/distance=yes"),
}
# seconds between two clocks may be those since 1970; no unit of length is smaller than a picometre
_PAIR_BOUNDS = {"read.delays": (-4e9, 4e9), "read.scale": (1e-12, LARGEST)}
# those that may be inf: all pairs or features count, as in the papers
_ENDLESS = ("features.max_distance", "features.robust_scale", "solve.max_distance", "solve.robust_scale")
_BOUNDS: dict[str, tuple[float, float]] = {
    **{f"limits.{f.name}": (1, 1 << 60) for f in fields(LimitSettings) if f.name != "seconds"},
    "read.max_points": (1, MOST),
    "detect.points": (1, 8192),
    "start.scale": (0.0, SIZES[1]),
    "start.headings": (1, 360),
    "start.frames": (1, 1000),
    "start.seconds": (0.0, 1000.0),
    "start.directions": (1, 1000),
    "start.size_frames": (1, 10_000),
    "features.robust_scale": (1e-4, LARGEST),
    "solve.max_steps": (1, 10_000),
    "solve.sampling": (0, 1),
    "solve.robust_scale": (1e-4, LARGEST),
    "flexible.particles": (2, 100_000),
    "flexible.head_particles": (2, 100_000),
    "flexible.layers": (1, 10),
    "flexible.velocity": (0, 1),
    "flexible.depth_share": (0, 1),
    "flexible.relaxations": (1, 100),
    "flexible.refine": (0, 100),
    "flexible.follow_level": (0, 1),
    "flexible.follow_up": (0, 1),
    "flexible.mass_base": (1e-3, 1e3),
    "flexible.points": (16, 8192),
    "track.prior_interval": (1e-4, LARGEST),
    "track.patience": (1, 1_000_000),
    "track.chunk": (1, 100_000),
}
_WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
