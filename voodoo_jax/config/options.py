"""Every option in one place, nested by stage. The same names serve Python, TOML files and command line flags."""

from dataclasses import dataclass, field
from typing import Any, Literal

from voodoo_jax.config.flexible_options import FlexibleSettings as FlexibleSettings


@dataclass(frozen=True)
class ReadSettings:
    """Reading a log: topics, units, calibration and transforms."""

    topics: tuple[str, ...] = ()
    """Depth topics to use; empty: all."""
    laser: bool = False
    """Use laser scanners too, as sources of 3D points."""
    stereo: bool = True
    """Use stereo pairs (calibrated images, topics named left and right) of rigs that have no other depth data."""
    skin: bool = False
    """Detect regions of skin colour in calibrated colour images; each is a line of sight to the feature skin."""
    pose_net: str = ""
    """Detect a person's key points in calibrated colour images by a network; each is a line of sight. mediapipe: the
    network that the extra [pose] installs; or a wheel or folder with MediaPipe's files; empty: none."""
    images: bool = False
    """Also give calibrated colour images to the tracker; `--tracker flexible` switches this on."""
    matching: Literal["fine", "none"] = "fine"
    """Stereo matching. fine: dense, with sub-pixel accuracy; none: no matching, for trackers that use the images
    directly."""
    features: bool = True
    """Use named 2D and 3D features too: detections, annotations, points, markers."""
    fixed_frame: str = ""
    """Frame of all results; empty: the root of the transform tree."""
    min_range: float = 0.1
    """Nearer measurements are dropped, metres."""
    max_range: float = 12.0
    """Farther measurements are dropped, metres."""
    max_points: int = 120_000
    """Most points of a sensor in a frame; of larger depth images every second, third, ... row and column is used."""
    parts: tuple[str, ...] = ()
    """Topic = limb, or topic = body: all points of this depth topic are on that part, by a segmentation."""
    label_field: str = ""
    """Field of point clouds with each point's label; empty: a field with a name like label, if labels are given."""
    labels: tuple[str, ...] = ()
    """Value of that field = limb, body or free. Other values are free; without entries, all except 0 are body."""
    weights: tuple[str, ...] = ()
    """Topic = weight of each of its points or features; a point of a depth camera weighs 1."""
    up: str = ""
    """Upward direction in the fixed frame: x, y, z, -x, -y, -z, or three numbers with commas; empty: estimated."""
    scale: tuple[str, ...] = ()
    """Topic = metres per unit of its distances or coordinates (0.001: millimetres); without an entry: estimated."""
    mirror: tuple[str, ...] = ()
    """Topic = axis (x, y or z) to invert. For named points in left-handed coordinates, such as Unity's, and for clouds.
    For depth images: x if they are mirrored left to right, y if upside down. none, for named points: coordinates are
    right-handed, but left and right are exchanged in the names."""
    radial: tuple[str, ...] = ()
    """Depth image topic = yes if its values are distances along the rays, no if they are depths along the optical axis;
    without an entry: estimated from floor and walls."""
    delays: tuple[str, ...] = ()
    """Topic = seconds by which its stamps are late (negative: early); without an entry: estimated."""
    camera: tuple[str, ...] = ()
    """Calibration of depth images and cameras: topic = file (a camera_info as YAML, TOML or JSON), or one file for all
    images without a calibration in the log."""
    types: tuple[str, ...] = ()
    """Message definitions (.msg files of their packages) that a ROS 2 SQLite bag lacks; those of common drivers are
    known."""
    transform: tuple[str, ...] = ()
    """Transforms that are missing or wrong in the log, each a text: "parent child x y z qx qy qz qw" (metres)."""


@dataclass(frozen=True)
class DetectSettings:
    """Separating the person (or other body) from floor, walls and furniture."""

    people: int = 0
    """Largest number of people (or other bodies) to track, those in view for longest first; 0: all; 1: only the main
    one."""
    floor_margin: float = 0.035
    """Points lower than this above the floor are dropped, metres."""
    link: float = 0.12
    """Points closer than this are connected, metres."""
    min_height: float = 0.65
    """At the start, objects lower than this are not taken for the body, as a share of the body's height at rest."""
    move: float = 0.25
    """Largest distance that a part of the body moves between frames, metres."""
    forget: int = 30
    """After this number of frames without the body the search covers the whole view again."""
    reach: float = 0.7
    """Objects farther than this from the body's last bounding box are dropped, metres."""
    points: int = 1024
    """Points per frame for the tracker, chosen at random from more. If a single sensor sees twice as many on a single
    person, frames are subsampled evenly before detection."""
    noise: float = 0.03
    """Points noisier than this weigh less, in inverse proportion to their variance, metres; 0: equal weights."""
    skip: tuple[str, ...] = ()
    """Names of stages to skip; looks_ahead: all that use later frames."""


@dataclass(frozen=True)
class StartSettings:
    """Start of the tracker: pose, position and size."""

    scale: float = 0.0
    """The body's scale (a person's stature) in metres; 0: measured from the cloud."""
    headings: int = 12
    """Number of headings to try, evenly spread; a third of them where the learned eye has seen a person."""
    frames: int = 6
    """Most frames over which the trials are compared."""
    seconds: float = 0.4
    """Longest time over which the trials are compared, but at least three frames."""
    directions: int = 26
    """Number of directions to try for a held object that appears."""
    size_frames: int = 12
    """Frames over which the size is measured."""
    later: tuple[float, ...] = (0.5, 1.0, 1.5, 2.5, 4.0, 6.0, 10.0)
    """After a doubtful start, times in seconds of further starts; from the clearest one the body is tracked backwards
    to the beginning (not online)."""
    sure: float = 0.00014
    """A start is certain if its mean squared distance, less that of noise, is below this, square metres."""


@dataclass(frozen=True)
class FeatureSettings:
    """Named features: their points on the body, and their weights (Knoop 2007, secs. 5.1 and 6)."""

    names: tuple[str, ...] = (
        "face=sellion",
        "left_hand=l_metacarpal_phalanx_3",
        "right_hand=r_metacarpal_phalanx_3",
        "skin=sellion|l_metacarpal_phalanx_3|r_metacarpal_phalanx_3",
    )
    """Feature in the log = point or joint centre of the body; the body's own names need no entry. With several points,
    separated by |, the feature is the nearest of them."""
    weights: tuple[str, ...] = ("face=4", "left_hand=5.5", "right_hand=5.5", "skin=3")
    """Feature in the log = weight; a point of a depth camera weighs 1. The papers: face 30, hand 20."""
    weight: float = 20.0
    """Weight of other features."""
    robust_scale: float = 0.12
    """Distance at which the weight of a feature is down to a quarter, metres (robust against wrong detections)."""
    max_distance: float = 0.5
    """Features farther than this from their point on the body are ignored, metres."""


@dataclass(frozen=True)
class SolveSettings:
    """The ICP of one frame (Knoop 2007, sec. 5.2)."""

    solver: Literal["coupled", "per_limb"] = "coupled"
    """coupled: all limbs and bands in one Gauss-Newton step; per_limb: limb by limb, as in the papers."""
    damping: float = 1e-4
    """Levenberg-Marquardt damping of the coupled solver, as a share of the diagonal."""
    max_steps: int = 30
    """Largest number of ICP steps per frame (the papers: 6 online, 3 to 15 in general)."""
    stretch: float = 2.0
    """Largest factor by which successive steps of a limb in the same direction are extrapolated (coupled); 1: none."""
    epsilon: float = 1e-7
    """Stop when the mean squared distance changes by less, square metres; 0: take all steps. If the
    prediction was close, the coupled solver also stops if it changes by less than ten times this, or rises."""
    ratio: float = 0.6
    """r: weight of a joint's bands relative to the measured weight of the limb (the papers: 0.4 to 0.7)."""
    floor: float = 0.03
    """Least weight to which bands refer, as a share of the frame's weight, so that bands hold limbs without points."""
    body_enlarge: float = 0.4
    """Points outside the body's box enlarged by this are dropped, metres."""
    limb_enlarge: float = 0.35
    """Points outside a limb's box enlarged by this are not matched to the limb, metres."""
    sampling: float = 1.0
    """Share of a limb's points that are used, evenly spread."""
    sampling_min: int = 0
    """Least number of points that a limb keeps, if it has as many."""
    sampling_max: int = 8192
    """Largest number of points that a limb uses."""
    max_distance: float = 0.35
    """Largest distance of a pair, metres."""
    robust_scale: float = 0.15
    """Distance at which the weight of a pair is down to a quarter (Geman-McClure), metres; inf: equal weights."""
    overlap: Literal["exclusive", "shared", "adjacent", "soft"] = "exclusive"
    """Rule for a point in several limbs' boxes. soft: each limb gets a share of it, the nearest one most, so that
    gradients include points that change limbs."""
    softness: float = 0.02
    """Distance over which the shares change from one limb to the next (overlap soft), metres."""
    near_side: bool = True
    """Match points to the side of a limb that faces their sensor."""
    refine: int = 0
    """Iterations towards the exact closest point on elliptic limbs; 0: exact for round limbs only."""
    prior: float = 0.0003
    """Weight of the pull to the predicted pose, as a share of the frame's weight."""
    prior_radius: float = 0.4
    """Distance of the pull's pairs from the limb's centre, metres; a larger one holds rotations more."""
    steady: float = 8.0
    """Weight of the pull that holds a limb at rest, relative to the limb's measured weight; 0: none."""
    steady_distance: float = 0.004
    """Distance from the predicted pose at which that pull is down to a quarter, metres: moving limbs are not held."""
    limits: float = 0.1
    """Weight of pairs that turn joints back to their limits, relative to a joint's bands; 0: violations are only
    reported."""
    collisions: float = 0.0
    """Weight of pairs that push limbs apart, relative to a joint's bands; 0: collisions are only reported."""
    collision_margin: float = 0.02
    """Overlap of limbs, beyond that of the rest pose, that is tolerated before they are pushed apart, metres."""


@dataclass(frozen=True)
class TrackSettings:
    """Tracking from frame to frame."""

    damping: float = 0.7
    """Share of the last frame's velocity in the prediction (0: no motion, 1: constant velocity)."""
    prior_interval: float = 0.035
    """For longer frame intervals, the pull to the prediction decreases with the square of the interval, seconds."""
    still_speed: float = 0.2
    """Limbs slower than this are held in place (solve.steady), metres per second."""
    hidden_rest: float = 0.8
    """Time in which limbs without points return to their rest pose, seconds (0: never); meanwhile they follow their
    parents."""
    hidden_weight: float = 8.0
    """Weight of the points (1 each without noise) at which a limb counts as half hidden."""
    lost_explained: float = 0.8
    """A frame is lost if less than this share of the person's points is explained."""
    lost_confidence: float = 0.4
    """A frame is lost if the mean confidence of the joints is below this."""
    patience: int = 15
    """After this number of successive lost or empty frames the search for the body starts again."""
    chunk: int = 128
    """Frames per compiled run."""
    skip: tuple[str, ...] = ()
    """Names of stages to skip; looks_ahead: all that use later frames, so that each frame depends only on earlier
    ones."""


@dataclass(frozen=True)
class LimitSettings:
    """Limits for one log: data beyond a limit is refused with a message, and the rest is read."""

    # the largest message of sensors in use is a raw image of 32 Mpixel (128 MB); recorders close chunks at some MB
    chunk_bytes: int = 256 << 20
    """Bytes of a chunk, or of a compressed message, unpacked."""
    # a record of one takes 500 bytes of memory beside its content (measured), so this is half a GB
    chunk_messages: int = 1 << 20
    """Messages of a chunk."""
    # a log of dark images packs 500 : 1 (measured), zeros alone 10,000 : 1; the 4 GiB are for small logs
    log_bytes: int = 4 << 30
    """Bytes of a whole log, unpacked, in addition to limits.log_times its size."""
    log_times: int = 1000
    """Size of a log, unpacked, as a multiple of its file size (see limits.log_bytes)."""
    # the largest depth cameras and stereo cameras have 4096 x 4096 pixels
    pixels: int = 1 << 24
    """Pixels of an image, by its header."""
    # lidars have 0.3 million in a turn; terrestrial scanners some millions
    points: int = 1 << 24
    """Points of a cloud or of a turn of a laser scanner."""
    # definitions of ROS with all they include have at most 30 kB, those of Foxglove 10 kB
    schema_bytes: int = 128 << 10
    """Bytes of a schema."""
    # the longest of common_interfaces (InteractiveMarkerUpdate) has 700; 4000 take 0.4 s (measured)
    schema_lines: int = 4000
    """Lines of a schema, including comments and included definitions."""
    # with nested ones the largest of common_interfaces (InteractiveMarkerUpdate) has 800
    schema_fields: int = 10_000
    """Fields of a schema, including nested ones."""
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
    """Moving transforms of a log."""
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
    """Processor seconds until a log must yield its next frame, for each started GiB of its size; 0: no limit."""


@dataclass(frozen=True)
class Change:
    """A change of the body during tracking (Knoop 2006, sec. IV); a table [[change]] in a settings file."""

    time: float
    """Time of the change, seconds after the first frame."""
    scale: float = 0.0
    """New scale of the body (a person's stature), metres; 0: unchanged."""
    sizes: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """New sizes of limbs: both semi-axes of the bottom ellipse, of the top ellipse, length; metres."""
    remove: tuple[str, ...] = ()
    """Limbs or held objects to remove, with everything attached to them."""
    add: Any = ""
    """A limb that was removed, or a held object: a body file (in Python also a Body)."""
    to: str = ""
    """Limb that carries the object."""
    at: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Position of the joint in the frame of the carrying limb, metres."""
    grip: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Position of the joint in the frame of the object's first limb, metres."""
    axis: tuple[float, ...] = ()
    """Initial direction of the object in the carrying limb's frame; empty: found by trials."""
    joint_axes: tuple[float, ...] = (0.0, 0.0)
    """Semi-axes of the joint's ellipse, metres; both 0: the object turns freely."""
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
    """icp: cylinders on 3D points (Knoop et al. 2006, 2007); flexible: particle filters on images (Hecht et al. 2009);
    both: both, merged."""
    changes: tuple[Change, ...] = ()
    online: bool = False
    """Use no later frames, as on a robot."""
    online_lag: float = 0.0
    """Permitted delay of results with online, seconds."""

    def looks_ahead(self, section: Literal["detect", "track"]) -> bool:
        """Whether later frames may be used there."""
        return not self.online and LOOKS_AHEAD not in getattr(self, section).skip

    def skips(self, section: Literal["detect", "track"], stage: str, looks_ahead: bool) -> bool:
        """Whether a stage is left out; `looks_ahead`: it uses later frames."""
        return stage in getattr(self, section).skip or (looks_ahead and not self.looks_ahead(section))


LOOKS_AHEAD = "looks_ahead"  # in place of a stage's name: all that use later frames


class SettingsError(ValueError):
    """A settings file that cannot be used; says where, what, and what would be right."""
