"""Every option in one place, nested by stage. The same names serve Python, TOML files and command line flags."""

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class ReadSettings:
    """How a log becomes frames."""

    topics: tuple[str, ...] = ()
    """Depth topics to use; empty: all that are found."""
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
class SolveSettings:
    """The ICP of one frame (Knoop 2007, sec. 5.2)."""

    solver: Literal["coupled", "per_limb"] = "coupled"
    """coupled: all limbs and bands in one Gauss-Newton step; per_limb: the papers' absolute orientation limb by limb."""
    damping: float = 1e-4
    """Levenberg-Marquardt damping of the coupled solver, as a share of the diagonal."""
    max_steps: int = 20
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
    prior: float = 0.001
    """Weight of the pull to the predicted pose, as a share of the frame's weight."""
    prior_radius: float = 0.4
    """Where the pull's pairs sit: larger holds rotations more, metres."""


@dataclass(frozen=True)
class TrackSettings:
    """From frame to frame."""

    damping: float = 0.7
    """Share of the last frame's velocity that is expected to go on (0: stand still, 1: constant velocity)."""
    lost_explained: float = 0.6
    """Less than this share of the person's points explained: the frame counts as lost."""
    chunk: int = 128
    """Frames per compiled run."""


@dataclass(frozen=True)
class Settings:
    """All options."""

    read: ReadSettings = field(default_factory=ReadSettings)
    person: PersonSettings = field(default_factory=PersonSettings)
    start: StartSettings = field(default_factory=StartSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
