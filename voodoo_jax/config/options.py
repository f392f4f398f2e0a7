"""Every option in one place, nested by stage. The same names serve Python, TOML files and command line flags."""

from dataclasses import dataclass, field
from typing import Any, Literal

from voodoo_jax.config.flexible_options import FlexibleSettings as FlexibleSettings


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
    pose_net: str = ""
    """Look for a person's key points in calibrated colour images by a network: each is a line of sight. mediapipe: the
    one that the extra [pose] installs; or a wheel or a folder that has MediaPipe's files; empty: none."""
    images: bool = False
    """Give calibrated colour images to the tracker too: `--tracker flexible` sees to it."""
    matching: Literal["fine", "none"] = "fine"
    """How stereo pairs are matched. fine: densely, to fractions of a pixel; none: not at all, for trackers that have
    the images."""
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
    up: str = ""
    """Which way is up in the fixed frame: x, y, z, -x, -y, -z, or three numbers with commas; empty: it is found."""
    scale: tuple[str, ...] = ()
    """Topic = metres per unit of its distances or coordinates (0.001: millimetres); without an entry it is found."""
    mirror: tuple[str, ...] = ()
    """Topic = axis (x, y or z) that is turned round: of named points in left-handed coordinates, such as Unity's, and
    of clouds; of depth images x where they are mirrored left to right, y upside down. none, of named points:
    coordinates are right-handed, and it is names that are on the wrong sides."""
    radial: tuple[str, ...] = ()
    """Depth image topic = yes if its values are distances along the rays, no if they are depths along the optical axis;
    without an entry floor and walls decide."""
    delays: tuple[str, ...] = ()
    """Topic = seconds by which its stamps are late (negative: early); without an entry clocks are brought together."""
    camera: tuple[str, ...] = ()
    """Calibration of depth images and cameras: topic = file (a camera_info as YAML, TOML or JSON), or one file for all
    images whose calibration is not in the log."""
    types: tuple[str, ...] = ()
    """Definitions of messages (.msg files of their packages) that an SQLite bag of ROS 2 lacks; usual drivers' are
    known."""
    transform: tuple[str, ...] = ()
    """Transforms that the log lacks or has wrong: "parent child x y z qx qy qz qw" (metres), each of them a text."""


@dataclass(frozen=True)
class DetectSettings:
    """How the person (or any tracked body) is separated from floor, walls and furniture."""

    people: int = 0
    """How many people (or other bodies) are tracked at most, those in view for longest first; 0: all in view; 1: the
    main one only."""
    floor_margin: float = 0.035
    """Points lower than this above the floor are dropped, metres."""
    link: float = 0.12
    """Points closer than this belong to the same thing, metres."""
    min_height: float = 0.65
    """A thing lower than this is not taken for the body at the start, as a share of the body's height at rest."""
    move: float = 0.25
    """How far a part of the body may have moved since the last frame, metres."""
    forget: int = 30
    """After this number of frames without the body the search covers the whole view again."""
    reach: float = 0.7
    """Things farther than this from the box that the body was in are dropped, metres."""
    points: int = 1024
    """Points per frame given to the tracker: a random choice where there are more. Where one person is followed by one
    sensor that sees twice as many on them, only an even share of a frame's points is looked at from the start."""
    noise: float = 0.03
    """Noisier points than this weigh less, in inverse proportion to their variance, metres; 0: all weigh alike."""
    skip: tuple[str, ...] = ()
    """Stages that are left out, by name; looks_ahead: all that use later frames."""


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
    """After a doubtful beginning, times in seconds at which a clearer start is tried; from there the body is tracked
    backwards to the beginning (not online)."""
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
    """Largest factor by which successive steps of a limb in the same direction are extrapolated (coupled); 1: none."""
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
    overlap: Literal["exclusive", "shared", "adjacent", "soft"] = "exclusive"
    """Rule for a point in several limbs' boxes. soft: each limb gets a share of it, the nearest one most, so that
    gradients include points that go from limb to limb."""
    softness: float = 0.02
    """Distance over which shares go from one limb to the next (overlap soft), metres."""
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
    """Distance from the predicted place at which that pull is down to a quarter, metres: moving limbs are not held."""
    limits: float = 0.1
    """Weight of pairs that turn joints back into their limits from frame to frame, relative to a joint's bands; 0: only
    reported."""
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
    """Time in which limbs without points return to their rest pose, seconds (0: never); meanwhile they follow their
    parents."""
    hidden_weight: float = 8.0
    """Weight of the points (1 each if not noisy) at which a limb counts as half hidden."""
    lost_explained: float = 0.8
    """Less than this share of the person's points explained: the frame counts as lost."""
    lost_confidence: float = 0.4
    """So small a share of the joints expected within 10 cm: the frame counts as lost."""
    patience: int = 15
    """After this number of successive lost or empty frames the search for the body starts anew."""
    chunk: int = 128
    """Frames per compiled run."""
    skip: tuple[str, ...] = ()
    """Stages that are left out, by name; looks_ahead: all that use later frames, so that each frame is tracked by what
    came before it only."""


@dataclass(frozen=True)
class LimitSettings:
    """Limits for one log: anything beyond a limit is refused with a sentence, and the rest is read."""

    # the largest message of sensors in use is a raw image of 32 Mpixel (128 MB); recorders close chunks at some MB
    chunk_bytes: int = 256 << 20
    """Bytes of a chunk, or of a message that is packed by itself, unpacked."""
    # a record of one takes 500 bytes of memory beside its content (measured), so this is half a GB
    chunk_messages: int = 1 << 20
    """Messages of a chunk."""
    # a log of dark images packs 500 : 1 (measured), zeros alone 10,000 : 1; the 4 GiB are for small logs
    log_bytes: int = 4 << 30
    """Bytes of a whole log, unpacked, beyond limits.log_times its size."""
    log_times: int = 1000
    """So many times its size a log may have besides, unpacked."""
    # the largest depth cameras and stereo cameras have 4096 x 4096 pixels
    pixels: int = 1 << 24
    """Pixels of an image, as its header says."""
    # lidars have 0.3 million in a turn; terrestrial scanners some millions
    points: int = 1 << 24
    """Points of a cloud or of a turn of a laser scanner."""
    # definitions of ROS with all they include have at most 30 kB, those of Foxglove 10 kB
    schema_bytes: int = 128 << 10
    """Bytes of a schema."""
    # the longest of common_interfaces (InteractiveMarkerUpdate) has 700; 4000 take 0.4 s (measured)
    schema_lines: int = 4000
    """Lines of a schema, fields or comments, with what it includes."""
    # fields with those of the fields: the largest of common_interfaces (InteractiveMarkerUpdate) has 800
    schema_fields: int = 10_000
    """Fields of a schema with those of the fields."""
    # robots record some hundred types of 100 lines
    schemas_bytes: int = 32 << 20
    """Bytes of all schemas of a log."""
    # robots record some hundred; MCAP has numbers for 65,536
    topics: int = 10_000
    """Topics of a log."""
    # whole-body marker sets have a hundred, pose nets 133 with hands and face
    names: int = 10_000
    """Different names of features, markers or coordinate frames of a log."""
    # 20 moving frames at 100 Hz are 7 million in an hour; one takes 80 bytes, and as much when they are sorted
    transforms: int = 1 << 23
    """Transforms of a log that move."""
    # 50 markers at 90 Hz are 16 million in an hour; one takes 100 bytes, and as much when they are gathered
    features: int = 1 << 24
    """Named features of a log, in all its messages together."""
    # a person with all fingers has 55, a quadruped robot 20; a program for them is compiled for each pair of limbs
    limbs: int = 256
    """Limbs of a body file."""
    # together with the libraries that read it (0.2 GB) this stays below 2 GB
    memory: int = 3 << 29
    """Bytes of memory for reading a file of another format."""
    # no recording at hand needs more than 6 s for its first frame (measured, one slow core): ten times that
    seconds: float = 60.0
    """Seconds of a processor in which a log must yield its next frame, for each GiB begun of its size; 0: no limit."""


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
    """Direction in the carrying limb's frame in which the thing points at first; empty: trials find it."""
    joint_axes: tuple[float, ...] = (0.0, 0.0)
    """Semi-axes of the joint's ellipse, metres: both 0 lets the thing turn freely."""
    weight: float = 1.0
    """Weight of the joint."""


@dataclass(frozen=True)
class Settings:
    """All options."""

    read: ReadSettings = field(default_factory=ReadSettings)
    detect: DetectSettings = field(default_factory=DetectSettings)
    start: StartSettings = field(default_factory=StartSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    flexible: FlexibleSettings = field(default_factory=FlexibleSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    tracker: Literal["icp", "flexible", "both"] = "icp"
    """icp: cylinders fitted to 3D points (Knoop et al. 2006, 2007); flexible: particle filters on stereo or colour
    and depth images (Hecht et al. 2009); both: each limb by both."""
    changes: tuple[Change, ...] = ()
    online: bool = False
    """Use no later frames, as on a robot."""
    online_lag: float = 0.0
    """With online: seconds by which results may be late; frames are tracked back in time from there."""

    def looks_ahead(self, section: Literal["detect", "track"]) -> bool:
        """Whether later frames may be used there."""
        return not self.online and LOOKS_AHEAD not in getattr(self, section).skip

    def skips(self, section: Literal["detect", "track"], stage: str, looks_ahead: bool) -> bool:
        """Whether a stage is left out; `looks_ahead`: it uses later frames."""
        return stage in getattr(self, section).skip or (looks_ahead and not self.looks_ahead(section))


LOOKS_AHEAD = "looks_ahead"  # in place of a stage's name: all that use later frames


class SettingsError(ValueError):
    """A settings file that cannot be used; says where, what, and what would be right."""
