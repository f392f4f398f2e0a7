"""Every option in one place, nested by stage. The same names serve Python, TOML files and command line flags."""

import ast
import inspect
import json
import os
import textwrap
import tomllib
from dataclasses import Field, dataclass, field, fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args, get_origin


@dataclass(frozen=True)
class ReadSettings:
    """How a log becomes frames."""

    topics: tuple[str, ...] = ()
    """Depth topics to use; empty: all that are found."""
    laser: bool = False
    """Use laser scanners too: their points are taken like a depth camera's."""
    features: bool = True
    """Use named 2D and 3D features too: detections, annotations, points, markers."""
    fixed_frame: str = ""
    """Frame in which everything is expressed; empty: the root of the transform tree."""
    min_range: float = 0.1
    """Nearer measurements are dropped, metres."""
    max_range: float = 12.0
    """Farther measurements are dropped, metres."""
    max_points: int = 40_000
    """Per sensor and frame; a denser depth image is read at every second, third, ... row and column."""


@dataclass(frozen=True)
class PersonSettings:
    """How the person (or any tracked body) is told apart from floor, walls and furniture."""

    floor_margin: float = 0.035
    """Points lower than this above the floor are dropped, metres."""
    link: float = 0.12
    """Points closer than this belong to the same thing, metres."""
    min_height: float = 0.65
    """A thing lower than this is not taken for the body at the start, as a share of the body's height at rest."""
    move: float = 0.25
    """How far a part of the body may have moved since the last frame, metres."""
    forget: int = 30
    """After so many frames without the body it is looked for everywhere again."""
    reach: float = 1.0
    """Things farther than this from where the body was are dropped, metres; grows with the body's size."""
    points: int = 1024
    """Points per frame given to the tracker: a random choice where there are more."""


@dataclass(frozen=True)
class StartSettings:
    """How the tracker finds pose, place and size at the beginning."""

    scale: float = 0.0
    """The body's scale (a person's stature) in metres; 0: measured from the cloud."""
    headings: int = 12
    """Directions that are tried, evenly spread."""
    frames: int = 6
    """Frames over which the trials are compared."""
    size_frames: int = 12
    """Frames over which the size is measured."""


@dataclass(frozen=True)
class FeatureSettings:
    """Named features: which point of the body each is, and what it weighs (Knoop 2007, secs. 5.1 and 6)."""

    names: tuple[str, ...] = (
        "face=sellion",
        "left_hand=l_metacarpal_phalanx_3",
        "right_hand=r_metacarpal_phalanx_3",
    )
    """Feature in the log = feature point or joint centre of the body; names of the body need no entry."""
    weights: tuple[str, ...] = ("face=10", "left_hand=7", "right_hand=7")
    """Feature in the log = weight; a point of a depth camera weighs 1. The papers: face 30, hand 20."""
    weight: float = 20.0
    """Weight of other features."""
    robust_scale: float = 0.12
    """Distance at which a feature counts a quarter, metres: wrong detections happen."""
    max_distance: float = 0.5
    """Features farther than this from their place on the body are ignored, metres."""


@dataclass(frozen=True)
class SolveSettings:
    """The ICP of one frame (Knoop 2007, sec. 5.2)."""

    solver: Literal["coupled", "per_limb"] = "coupled"
    """coupled: all limbs and bands in one Gauss-Newton step; per_limb: the papers' way, limb by limb."""
    damping: float = 1e-4
    """Levenberg-Marquardt damping of the coupled solver, as a share of the diagonal."""
    max_steps: int = 30
    """Most ICP steps per frame (the papers: 6 online, 3 to 15 in general)."""
    epsilon: float = 1e-7
    """Stop when the mean squared distance changes by less, square metres."""
    ratio: float = 0.6
    """r: weight of a joint's bands over the measured weight of the limb (the papers: 0.4 to 0.7)."""
    floor: float = 0.03
    """Bands refer to at least this share of the frame's weight, so that a limb nobody sees hangs on its bands."""
    body_enlarge: float = 0.4
    """Points outside the body's box enlarged by this are dropped, metres."""
    limb_enlarge: float = 0.35
    """Points outside a limb's box enlarged by this are not matched to the limb, metres."""
    max_distance: float = 0.35
    """Longest distance of a pair, metres."""
    robust_scale: float = 0.15
    """Distance at which a pair counts a quarter (Geman-McClure), metres; inf: all pairs count fully."""
    overlap: Literal["exclusive", "shared", "adjacent"] = "exclusive"
    """What becomes of a point in several limbs' boxes."""
    near_side: bool = True
    """Match points to the side of a limb that faces their sensor."""
    refine: int = 0
    """Iterations towards the exact closest point on elliptic limbs; 0: exact for round limbs only."""
    prior: float = 0.0003
    """Weight of the pull to the predicted pose, as a share of the frame's weight."""
    prior_radius: float = 0.4
    """Where the pull's pairs sit: larger holds rotations more, metres."""


@dataclass(frozen=True)
class TrackSettings:
    """From frame to frame."""

    damping: float = 0.7
    """Share of the last frame's velocity that is expected to go on (0: stand still, 1: constant velocity)."""
    prior_interval: float = 0.035
    """Over longer intervals between frames the pull to the prediction weakens with the square of the time, seconds."""
    lost_explained: float = 0.6
    """Less than this share of the person's points explained: the frame counts as lost."""
    patience: int = 15
    """After so many lost or empty frames on end the body is looked for anew."""
    chunk: int = 128
    """Frames per compiled run."""


@dataclass(frozen=True)
class Settings:
    """All options."""

    read: ReadSettings = field(default_factory=ReadSettings)
    person: PersonSettings = field(default_factory=PersonSettings)
    start: StartSettings = field(default_factory=StartSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    track: TrackSettings = field(default_factory=TrackSettings)


class SettingsError(ValueError):
    """A settings file that cannot be used; says where, what, and what would be right."""


def _check(stage: str, f: Field, value: Any) -> Any:
    """The value as the field wants it, or SettingsError."""
    name, default = f"{stage}.{f.name}", getattr(_STAGES[stage](), f.name)
    if get_origin(f.type) is Literal:
        if value not in get_args(f.type):
            raise SettingsError(f"{name} = {value!r}: must be one of {', '.join(map(repr, get_args(f.type)))}")
        return value
    if isinstance(default, tuple):
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise SettingsError(f"{name} = {value!r}: must be a list of texts")
        if name in _PAIRS:
            check_pairs(name, tuple(value), numbers=name == "features.weights")
        return tuple(value)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not type(default):
        raise SettingsError(f"{name} = {value!r}: must be {_WORDS[type(default)]}, such as {default!r}")
    if isinstance(value, (int, float)) and not isinstance(value, bool) and not value >= 0:
        raise SettingsError(f"{name} = {value!r}: must not be negative")
    low, high = _BOUNDS.get(name, (0, float("inf")))
    if isinstance(value, (int, float)) and not low <= value <= high:
        most = f" and at most {high}" if high < float("inf") else ""
        raise SettingsError(f"{name} = {value!r}: must be at least {low}{most}")
    return value


def check_pairs(name: str, words: tuple[str, ...], numbers: bool) -> dict[str, str]:
    """Words like "face=10" as a dictionary. Raises SettingsError."""
    for word in words:
        key, _, value = word.partition("=")
        try:
            good = bool(key and value) and (not numbers or float(value) >= 0)
        except ValueError:
            good = False
        if not good:
            wanted = "name=number, such as face=10" if numbers else "name=point, such as face=sellion"
            raise SettingsError(f"{name}: '{word}' must look like {wanted}")
    return dict(word.split("=", 1) for word in words)


def read_settings(path: str | os.PathLike[str], base: "Settings | None" = None) -> "Settings":
    """Settings from a TOML file with a table per stage; what it does not name stays as in `base`. Raises SettingsError,
    OSError."""
    base = base or Settings()
    try:
        content = tomllib.loads(Path(path).read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise SettingsError(f"{path}: not a TOML file: {problem}") from problem
    stages = {}
    for stage, values in content.items():
        if stage not in _STAGES or not isinstance(values, dict):
            near = get_close_matches(stage, _STAGES, 1)
            hint = f"; did you mean [{near[0]}]?" if near else f"; there are {', '.join(f'[{s}]' for s in _STAGES)}"
            raise SettingsError(f"{path}: [{stage}] is no stage{hint}")
        known = {f.name: f for f in fields(_STAGES[stage])}
        checked = {}
        for name, value in values.items():
            if name not in known:
                near = get_close_matches(name, known, 1)
                hint = f"; did you mean '{near[0]}'?" if near else f"; there are {', '.join(known)}"
                raise SettingsError(f"{path}: [{stage}] has no option '{name}'{hint}")
            try:
                checked[name] = _check(stage, known[name], value)
            except SettingsError as problem:
                raise SettingsError(f"{path}: {problem}") from None
        stages[stage] = replace(getattr(base, stage), **checked)
    return replace(base, **stages)


def check_settings(settings: "Settings") -> None:
    """Raises SettingsError for a value that a settings file could not have: flags and Python reach here unchecked."""
    for stage, cls in _STAGES.items():
        for f in fields(cls):
            value = getattr(getattr(settings, stage), f.name)
            _check(stage, f, list(value) if isinstance(value, tuple) else value)


def _help_texts(cls: type) -> dict[str, str]:
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
        texts = _help_texts(cls)
        lines += ["", f"# {cls.__doc__}", f"[{stage}]"]
        for f in fields(cls):
            value = getattr(getattr(settings, stage), f.name)
            written = json.dumps(list(value)) if isinstance(value, tuple) else json.dumps(value)
            written = {"Infinity": "inf"}.get(written, written)
            choices = f" ({', '.join(get_args(f.type))})" if get_origin(f.type) is Literal else ""
            lines += [f"# {texts[f.name]}{choices}", f"{f.name} = {written}"]
    return "\n".join(lines) + "\n"


_STAGES: dict[str, type] = {
    "read": ReadSettings,
    "person": PersonSettings,
    "start": StartSettings,
    "features": FeatureSettings,
    "solve": SolveSettings,
    "track": TrackSettings,
}
_PAIRS = ("features.names", "features.weights")
_BOUNDS: dict[str, tuple[float, float]] = {
    "read.max_points": (1, float("inf")),
    "person.points": (1, 8192),
    "start.headings": (1, 360),
    "start.frames": (1, 1000),
    "start.size_frames": (1, 10_000),
    "features.robust_scale": (1e-4, float("inf")),
    "solve.max_steps": (1, 10_000),
    "solve.robust_scale": (1e-4, float("inf")),
    "track.prior_interval": (1e-4, float("inf")),
    "track.patience": (1, 1_000_000),
    "track.chunk": (1, 100_000),
}
_WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
