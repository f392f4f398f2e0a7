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
    stereo: bool = True
    """Use pairs of calibrated images (topics named left and right) of rigs that have no other depth data."""
    skin: bool = False
    """Look for regions of skin colour in calibrated colour images: each is a line of sight to the feature skin."""
    features: bool = True
    """Use named 2D and 3D features too: detections, annotations, points, markers."""
    fixed_frame: str = ""
    """Frame in which everything is expressed; empty: the root of the transform tree."""
    min_range: float = 0.1
    """Nearer measurements are dropped, metres."""
    max_range: float = 12.0
    """Farther measurements are dropped, metres."""
    max_points: int = 120_000
    """Per sensor and frame; a denser depth image is read at every second, third, ... row and column."""
    parts: tuple[str, ...] = ()
    """Depth topic = limb, or topic = body: a segmentation has found all its points to be on that part of the person."""
    label_field: str = ""
    """Field of point clouds that says which part a point is on; empty: one named like label, if labels are given."""
    labels: tuple[str, ...] = ()
    """Value of that field = limb, body or free; others are free, but without any entry all except 0 are body."""
    weights: tuple[str, ...] = ()
    """Topic = weight of each of its points or features; a point of a depth camera weighs 1."""


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
    ahead: bool = True
    """Tell furniture that the body touches, and seats, by all frames; false: by those before each frame only."""
    steady: bool = True
    """Take out how the sensors move of which no transform tells, by floor and walls."""
    noise: float = 0.03
    """Noisier points than this weigh less, in inverse proportion to their variance, metres; 0: all weigh alike."""


@dataclass(frozen=True)
class StartSettings:
    """How the tracker finds pose, place and size at the beginning."""

    scale: float = 0.0
    """The body's scale (a person's stature) in metres; 0: measured from the cloud."""
    headings: int = 12
    """Directions that are tried, evenly spread."""
    frames: int = 6
    """Frames over which the trials are compared, at most."""
    seconds: float = 0.4
    """Time over which the trials are compared, at most; never less than three frames."""
    directions: int = 26
    """Directions that are tried for a held thing that appears."""
    size_frames: int = 12
    """Frames over which the size is measured."""
    later: tuple[float, ...] = (0.5, 1.0, 1.5, 2.5, 4.0, 6.0, 10.0)
    """Where the beginning is in doubt, times after it, in seconds, at which a clearer pose to start from is looked for;
    from there the body is followed back to the beginning (with track.both_ways only)."""
    sure: float = 0.00014
    """Mean squared distance beyond what noise makes, square metres, below which a start is in no doubt."""


@dataclass(frozen=True)
class FeatureSettings:
    """Named features: which point of the body each is, and what it weighs (Knoop 2007, secs. 5.1 and 6)."""

    names: tuple[str, ...] = (
        "face=sellion",
        "left_hand=l_metacarpal_phalanx_3",
        "right_hand=r_metacarpal_phalanx_3",
        "skin=sellion|l_metacarpal_phalanx_3|r_metacarpal_phalanx_3",
    )
    """Feature in the log = feature point or joint centre of the body; names of the body need no entry. Several points
    with | between: the feature is the nearest of them."""
    weights: tuple[str, ...] = ("face=4", "left_hand=5.5", "right_hand=5.5", "skin=3")
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
    stretch: float = 2.0
    """Where a limb's steps go the same way it goes up to so many times as far in one (coupled); 1: never farther."""
    epsilon: float = 1e-7
    """Stop when the mean squared distance changes by less, square metres (coupled, from where it was expected: by less
    than ten times that, or rises); 0: take all steps."""
    ratio: float = 0.6
    """r: weight of a joint's bands over the measured weight of the limb (the papers: 0.4 to 0.7)."""
    floor: float = 0.03
    """Bands refer to at least this share of the frame's weight, so that a limb nobody sees hangs on its bands."""
    body_enlarge: float = 0.4
    """Points outside the body's box enlarged by this are dropped, metres."""
    limb_enlarge: float = 0.35
    """Points outside a limb's box enlarged by this are not matched to the limb, metres."""
    sampling: float = 1.0
    """Share of a limb's points that are used, evenly spread."""
    sampling_min: int = 0
    """A limb keeps at least so many points, or all it has."""
    sampling_max: int = 8192
    """Most points that a limb uses."""
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
    steady: float = 8.0
    """Weight of the pull that holds a limb where it stands still, over the limb's measured weight; 0: none."""
    steady_distance: float = 0.004
    """Distance from the predicted place at which that pull is down to a quarter: who moves is not held, metres."""
    limits: float = 0.0
    """Weight of pairs that turn joints back into their limits, relative to a joint's bands; 0: only reported."""
    collisions: float = 0.0
    """Weight of pairs that push limbs out of each other, relative to a joint's bands; 0: only reported."""
    collision_margin: float = 0.02
    """Limbs may be in each other by so much more than in the rest pose before they are pushed, metres."""


@dataclass(frozen=True)
class TrackSettings:
    """From frame to frame."""

    damping: float = 0.7
    """Share of the last frame's velocity that is expected to go on (0: stand still, 1: constant velocity)."""
    prior_interval: float = 0.035
    """Over longer intervals between frames the pull to the prediction weakens with the square of the time, seconds."""
    still_speed: float = 0.2
    """Limbs that are slower are held where they are (solve.steady), metres per second."""
    hidden_rest: float = 0.8
    """Limbs that no point tells of go with their parents, and back to rest in about so many seconds (0: never)."""
    hidden_weight: float = 8.0
    """Weight of the points (1 each if not noisy) at which a limb counts as half hidden."""
    lost_explained: float = 0.8
    """Less than this share of the person's points explained: the frame counts as lost."""
    lost_confidence: float = 0.4
    """So small a share of the joints expected within 10 cm: the frame counts as lost."""
    patience: int = 15
    """After so many lost or empty frames on end the body is looked for anew."""
    chunk: int = 128
    """Frames per compiled run."""
    both_ways: bool = True
    """Track backwards in time too and combine both passes; false: each frame by what came before it only."""
    forearms: bool = True
    """In the end give the body that comes with the package forearms as long as its tracks ask for; with both passes."""


@dataclass(frozen=True)
class Change:
    """A change of the body while it is tracked (Knoop 2006, sec. IV); a table [[change]] in a settings file."""

    time: float
    """When, in seconds after the first frame."""
    scale: float = 0.0
    """New scale of the body (a person's stature), metres; 0: as it is."""
    sizes: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """New sizes of limbs: both semi-axes of the bottom ellipse, of the top ellipse, length; metres."""
    remove: tuple[str, ...] = ()
    """Limbs or held things that go, with all that hangs on them."""
    add: Any = ""
    """A limb that was removed, or a held thing: a body file (in Python also a Body)."""
    to: str = ""
    """Limb that carries the thing."""
    at: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Where it is held, in the frame of the limb that carries it, metres."""
    grip: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Where it is held, in the frame of the thing's first limb, metres."""
    axis: tuple[float, ...] = ()
    """Direction in the carrying limb's frame in which the thing points at first; empty: it is looked for."""
    joint_axes: tuple[float, ...] = (0.0, 0.0)
    """Semi-axes of the joint's ellipse, metres: both 0 lets the thing turn freely."""
    weight: float = 1.0
    """Weight of the joint."""


@dataclass(frozen=True)
class Settings:
    """All options."""

    read: ReadSettings = field(default_factory=ReadSettings)
    person: PersonSettings = field(default_factory=PersonSettings)
    start: StartSettings = field(default_factory=StartSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    changes: tuple[Change, ...] = ()


def preset(name: str) -> Settings:
    """Settings by name: "default", or "knoop2007", the chain and the values of Knoop 2007 as far as it gives them.

    These do not follow the defaults. Where the paper names a parameter and no value (enlargements, longest distance,
    epsilon), a usual one stands here. Its body is the built-in "human10". Raises SettingsError.
    """
    if name == "default":
        return Settings()
    if name != "knoop2007":
        raise SettingsError(f"there is no preset '{name}', but {', '.join(PRESETS)}")
    inf = float("inf")
    return Settings(
        read=ReadSettings(laser=True),
        person=PersonSettings(noise=0.0),
        features=FeatureSettings(
            # sec. 7
            weights=("face=30", "left_hand=20", "right_hand=20", "skin=20"), weight=20.0, robust_scale=inf,
            max_distance=inf,
        ),
        solve=SolveSettings(
            solver="per_limb", damping=0.0,
            max_steps=6,  # sec. 7: a good trade-off between time and accuracy
            epsilon=1e-7,
            ratio=0.55, floor=0.0,  # sec. 4.3: 0.4 < r < 0.7, of the limb's own measurements
            body_enlarge=0.2, limb_enlarge=0.1, max_distance=0.25, robust_scale=inf,
            overlap="exclusive",  # sec. 3.2: to the geometrically closest body part
            near_side=False, refine=4,
            prior=1e-6, prior_radius=0.4,  # next to nothing: keeps a limb where it is that nothing was measured of
            limits=0.0, collisions=0.0,
        ),
        track=TrackSettings(damping=0.0, both_ways=False),  # sec. 5.2: each frame starts from the last one's pose
    )  # fmt: skip


PRESETS = ("default", "knoop2007")


def online(settings: Settings) -> Settings:
    """The settings without a look into the future: every frame is tracked by what came before it, but for the half
    second after each start, over which starts and the person's size are compared."""
    return replace(
        settings, person=replace(settings.person, ahead=False), track=replace(settings.track, both_ways=False)
    )


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
        if default and isinstance(default[0], float):
            good = isinstance(value, list) and all(type(v) in (int, float) and 0 <= v < float("inf") for v in value)
            if not good:
                raise SettingsError(f"{name} = {value!r}: must be a list of numbers that are not negative")
            return tuple(float(v) for v in value)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise SettingsError(f"{name} = {value!r}: must be a list of texts")
        if name in _PAIRS:
            check_pairs(name, tuple(value), numbers=_PAIRS[name])
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
            good = bool(key and value) and (not numbers or 0 <= float(value) < float("inf"))
            if name == "read.labels":
                int(key)
        except ValueError:
            good = False
        if not good:
            raise SettingsError(f"{name}: '{word}' must look like {_EXAMPLES[name]}")
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
    changes = base.changes
    for stage, values in content.items():
        if stage == "change":
            if not isinstance(values, list) or not all(isinstance(table, dict) for table in values):
                raise SettingsError(f"{path}: changes are tables [[change]], with two brackets")
            changes = tuple(_change(path, n, table) for n, table in enumerate(values, 1))
            continue
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
    return replace(base, **stages, changes=changes)


def _change(path: str | os.PathLike[str], number: int, table: dict[str, Any]) -> Change:
    """One table [[change]]. A body file in it is looked for beside the settings file."""
    where = f"{path}: [[change]] number {number}"
    known = {f.name: getattr(Change(0.0), f.name) for f in fields(Change)}
    if "time" not in table:
        raise SettingsError(f"{where} has no 'time', the seconds after the first frame")
    values: dict[str, Any] = {}
    for name, value in table.items():
        if name not in known:
            near = get_close_matches(name, known, 1)
            raise SettingsError(f"{where} has no option '{name}'" + (f"; did you mean '{near[0]}'?" if near else ""))
        if name == "sizes":
            good = isinstance(value, dict) and all(_numbers(v, 5, above=0) for v in value.values())
            wanted = "a table such as { l_forearm = [0.04, 0.04, 0.03, 0.03, 0.25] }"
            value = tuple((limb, tuple(map(float, v))) for limb, v in value.items()) if good else value
        elif name == "remove":
            value = [value] if isinstance(value, str) else value
            good, wanted = isinstance(value, list) and all(isinstance(v, str) for v in value), "names of limbs"
            value = tuple(value) if good else value
        elif isinstance(known[name], str):
            good, wanted = isinstance(value, str), "a text"
        elif isinstance(known[name], float):
            good, wanted = _numbers([value], 1, above=-1e-300), "a number that is not negative"
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
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) and above < v < float("inf") for v in value)
    )


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
    texts = _help_texts(Change)
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


_STAGES: dict[str, type] = {
    "read": ReadSettings,
    "person": PersonSettings,
    "start": StartSettings,
    "features": FeatureSettings,
    "solve": SolveSettings,
    "track": TrackSettings,
}
# texts like "face=10", and whether a number stands behind the equals sign
_PAIRS = {
    "features.names": False,
    "features.weights": True,
    "read.parts": False,
    "read.labels": False,
    "read.weights": True,
}
_EXAMPLES = {
    "features.names": "name=point, such as face=sellion",
    "features.weights": "name=number, such as face=10",
    "read.parts": "topic=part, such as /people/points=body or /hands/left=l_forearm",
    "read.labels": "number=part, such as 3=head, 7=body or 0=free",
    "read.weights": "topic=number, such as /stereo/points=0.5",
}
_BOUNDS: dict[str, tuple[float, float]] = {
    "read.max_points": (1, float("inf")),
    "person.points": (1, 8192),
    "start.headings": (1, 360),
    "start.frames": (1, 1000),
    "start.seconds": (0.0, 1000.0),
    "start.directions": (1, 1000),
    "start.size_frames": (1, 10_000),
    "features.robust_scale": (1e-4, float("inf")),
    "solve.max_steps": (1, 10_000),
    "solve.sampling": (0, 1),
    "solve.robust_scale": (1e-4, float("inf")),
    "track.prior_interval": (1e-4, float("inf")),
    "track.patience": (1, 1_000_000),
    "track.chunk": (1, 100_000),
}
_WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
