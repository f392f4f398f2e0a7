"""What each command takes: one dataclass a command, its fields are the flags. Imports nothing heavy."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, Suppress, arg, subcommand

from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import (
    DetectSettings,
    FeatureSettings,
    FlexibleSettings,
    LimitSettings,
    ReadSettings,
    Settings,
    SolveSettings,
    StartSettings,
    TrackSettings,
)
from voodoo_jax.config.output_style import Names, Style

BODY_HELP = "Body to track: human, human10 (the papers' ten limbs), arm, dog, or a body file (TOML)."
PRESET_BODIES = {
    "default": "human", "knoop2007": "human10", "flexible": "human", "both": "human", "hecht2009": "human",
}  # fmt: skip
PRESET_HELP = (
    "Settings to start from; knoop2007 (with a body of ten limbs) and hecht2009: method and values of these papers."
)
Preset = Annotated[Literal["default", "knoop2007", "flexible", "both", "hecht2009"], arg(help=PRESET_HELP)]
CONFIG_HELP = "Settings file (TOML; `voodoo-jax config` prints one); flags override it."

PORTS = 1 << 16  # of TCP
FORMATS_HELP = "Formats: csv, trc, c3d, bvh, bvh-rigid, mot, gltf, usd; separate several by commas."
EXPORT_HELP = f"Also write the tracks for other programs. {FORMATS_HELP}"


@dataclass(frozen=True)
class Results(Style):
    """Output files."""

    out: str = "voodoo-out"
    """Folder for the results, or a URL."""
    picture: bool = False
    """Also write a picture, <log>.png."""
    html: bool = False
    """Also write <log>.html, an offline page for a browser."""
    report: bool = False
    """Also write report.html, with a row for each log."""
    export: Annotated[str, arg(help=EXPORT_HELP)] = ""
    smooth: float = 0.0
    """Standard deviation of a Gaussian filter over the tracks, seconds; 0: no filter."""


@dataclass(frozen=True)
class Running:
    """Processes, clusters and resuming."""

    again: bool = False
    """Track finished logs again."""
    verbose: bool = False
    """Print minor notes too."""
    workers: int = 0
    """Number of processes, each with one log at a time; 0: limited by cores, memory and logs."""
    shard: str = ""
    """Part of the logs, for array jobs: 2/8 is the second of eight. The parts are always the same."""
    engine: Literal["local", "batch", "ray"] = "local"
    """local: processes; batch: many logs in one program (GPUs); ray: a cluster (RAY_ADDRESS)."""
    compile_cache: str = ""
    """Folder for compiled programs, or off; empty: the user's cache folder."""
    log_timeout: float = 0.0
    """Seconds after which tracking of a log stops with an error; 0: never."""
    ray_cpus: int = 1
    """Cores for each log on Ray."""
    ray_gpus: float = 0.0
    """GPUs for each log on Ray; 0.25: a quarter of one."""
    ray_retries: int = 1
    """Restarts of a log after its Ray process or machine was lost."""


@dataclass(frozen=True)
class Replay:
    """Track people (or other bodies) in recorded logs.

    Writes <log>.tracks.npz (joints, poses, quality) and <log>.voodoo.mcap (for Foxglove), and <log>.2.tracks.npz, ...
    for further people. --help lists common options, --help-all also all settings, such as --start.scale.
    """

    logs: Annotated[Positional[tuple[str, ...]], arg(metavar="LOG ...")] = ()
    """Logs (MCAP, or any format that convert reads): files, folders, or URLs such as s3://bucket/*.mcap."""
    body: Annotated[str, arg(help=BODY_HELP)] = ""
    preset: Preset = "default"
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None
    results: OmitArgPrefixes[Results] = field(default_factory=Results)
    running: OmitArgPrefixes[Running] = field(default_factory=Running)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)


@dataclass(frozen=True)
class Live:
    """Track the main person (or body) during recording, with the settings of --online.

    Reads an MCAP file or the folder of a ROS 2 bag while a recorder writes it, or a Foxglove WebSocket (ws://..., such
    as foxglove_bridge). Publishes transforms and the body frame by frame, in a growing <log>.voodoo.mcap and, with
    --serve, as a Foxglove WebSocket. Ends with Ctrl-C or with the recording, and then writes the files of replay.
    --help lists common options, --help-all also all settings.
    """

    source: Annotated[Positional[str], arg(metavar="SOURCE")] = ""
    """A growing .mcap file, the folder of a bag, or ws://HOST:PORT."""
    out: str = "voodoo-out"
    """Folder for the results; created if missing."""
    serve: int = -1
    """Port of a Foxglove WebSocket on localhost, for transforms and the body; 0: any free port;
    -1: none."""
    names: Names = ""
    """Convention for joint names, such as common (left_wrist); empty: H-Anim."""
    idle: float = 10.0
    """Seconds without growth after which a file is finished."""
    body: Annotated[str, arg(help=BODY_HELP)] = ""
    preset: Literal["default", "knoop2007"] = "default"
    """Settings to start from: default; knoop2007: method and values of that paper (with its body of ten limbs)."""
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None
    compile_cache: str = ""
    """Folder for compiled programs, or off; empty: the user's cache folder."""
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)


@dataclass(frozen=True)
class UsualSettings(Settings):
    """Settings for the short help, which shows only those outside of sections."""

    read: Suppress[ReadSettings] = field(default_factory=ReadSettings)
    detect: Suppress[DetectSettings] = field(default_factory=DetectSettings)
    start: Suppress[StartSettings] = field(default_factory=StartSettings)
    features: Suppress[FeatureSettings] = field(default_factory=FeatureSettings)
    solve: Suppress[SolveSettings] = field(default_factory=SolveSettings)
    track: Suppress[TrackSettings] = field(default_factory=TrackSettings)
    flexible: Suppress[FlexibleSettings] = field(default_factory=FlexibleSettings)
    limits: Suppress[LimitSettings] = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Export:
    """Export tracks to formats of other programs: tables, biomechanics, animation.

    docs/results.md describes the contents, units and axes of each format.
    """

    tracks: Annotated[Positional[tuple[Path, ...]], arg(metavar="TRACKS ...")] = ()
    """Files <log>.tracks.npz of replay, or folders of them."""
    formats: Annotated[str, arg(name="as", help=FORMATS_HELP)] = ""
    out: Path | None = None
    """Folder for the files; default: beside the tracks."""
    style: OmitArgPrefixes[Style] = field(default_factory=Style)
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Convert:
    """Convert recordings of other formats to MCAP logs.

    Reads ROS 1 and RealSense bags (.bag), SQLite bags of ROS 2 (.db3, or their folder), recordings of Azure Kinect and
    Femto cameras (.mkv), skeletons (.json, .skeleton), tables of markers (.csv), C3D and TRC, folders of 16-bit depth
    images (PNG; of the TUM RGB-D benchmark, or with a camera file) and of point clouds (PCD, PLY). replay also accepts
    these.
    """

    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="RECORDING ...")] = ()
    """Recordings: files or folders."""
    out: Path | None = None
    """The log (.mcap) of one recording, or a folder for the logs of several."""
    camera: Path | None = None
    """Camera file (TOML) for depth images, or for an .mkv without calibration: width, height, fx, fy, cx, cy, unit
    (metres per count), rate (Hz)."""
    rate: float = 0.0
    """Rate of the files in a folder, Hz, if their names are not times (in seconds, or 19 digits of nanoseconds)."""
    types: tuple[str, ...] = ()
    """Message definitions (.msg files of their packages) that an SQLite bag lacks; those of usual drivers are known."""
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Info:
    """Show the topics of logs, and which of them replay would use."""

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG ...")]
    """Logs (MCAP, or any format that convert reads), or folders of them."""
    read: ReadSettings = field(default_factory=ReadSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class View:
    """Show a log and its tracks in a browser: cloud, bodies, markers, camera image with the bodies drawn over it.

    To share a view, use replay --html instead: it writes a self-contained file.
    """

    what: Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG [TRACKS]")] = ()
    """The log and, optionally, <log>.tracks.npz; further people (<log>.2.tracks.npz, ...) are shown as well."""
    port: int = 8080
    """Port on localhost; if it is in use, the next free one."""
    once: bool = False
    """Exit as soon as the viewer is ready, as a test."""
    read: ReadSettings = field(default_factory=ReadSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Demo:
    """Track the person in the included recording, and compare with ground truth.

    With --tracker flexible, simulate a stereo recording first and track that.
    """

    out: Path = Path("demo-out")
    """Folder for the results; created if missing."""
    tracker: Literal["icp", "flexible"] = "icp"
    """icp: a depth camera; flexible: a stereo camera's images."""


@dataclass(frozen=True)
class FitCommand:
    """Fit a body's sizes (or joints, bands, measurement weights) to recorded logs.

    Tracks the logs, fits the body so that held-back points lie on its surface, and tracks the logs again. The
    body file is written only if the fitted body is better, beyond noise, in time held back from the fit. A report (.md,
    .html, .png) lists the changes with their uncertainty, and why the body was written or not. Parameters that the logs
    do not determine keep their values. Fitted measurement weights and solver options go into a settings file
    (.config.toml) for --config. Use the body with `voodoo-jax replay LOG --body FILE`: replay estimates the size again
    and keeps the proportions. Ctrl-C stops the fit; the same command continues it.
    """

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG ...")] = ()
    """MCAP logs, or folders of them."""
    out: Path = Path("body.toml")
    """Body file to write if it is better; for several people, -1, -2, ... is added to its name."""
    keep_anyway: bool = False
    """Write the fitted body even if it is no better."""
    truth: tuple[Path, ...] = ()
    """Fit to the joint centres in these .npz files instead (time_ns, joints, joint_names), one for each log."""
    overwrite: bool = False
    """Replace files that exist."""
    body: Annotated[str, arg(help=BODY_HELP)] = ""
    tracker: Literal["", "icp", "flexible"] = ""
    """icp: fit to 3D points; flexible: fit to images. Empty: the tracker of --config."""
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None
    fit: Annotated[FitSettings, arg(name="")] = field(default_factory=FitSettings)


@dataclass(frozen=True)
class BodyCommand:
    """Make a body file from a robot description (URDF) or a skinned mesh (glTF).

    Links, or the parts of the mesh that follow a joint, become limbs: the best-fitting tapered elliptic cylinders.
    Notes list parts that fit badly. Track with `voodoo-jax replay LOG --body FILE --start.scale N`; this prints N.
    """

    source: Annotated[Positional[Path | None], arg(metavar="FILE")] = None
    """A .urdf, .glb or .gltf file."""
    out: Path = Path("body.toml")
    """Body file to write."""
    rest: tuple[str, ...] = ()
    """Joint values of the robot's rest pose, such as elbow=0.5, radians; others are 0. Avoid stretched chains and
    joints at their limits."""
    least: float = 0.03
    """Parts smaller than this are merged with their parents, metres."""
    overwrite: bool = False
    """Replace a file that exists."""
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Config:
    """Print the settings with their meanings, as a file for --config."""

    preset: Preset = "default"
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None


@dataclass(frozen=True)
class Layout:
    """Print a layout for Foxglove (Layouts, Import from file): body in a 3D panel, confidence and residual below it."""


Command = (
    Annotated[Demo, subcommand("demo")]
    | Annotated[Replay, subcommand("replay")]
    | Annotated[Live, subcommand("live")]
    | Annotated[Info, subcommand("info")]
    | Annotated[View, subcommand("view")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Convert, subcommand("convert")]
    | Annotated[FitCommand, subcommand("fit")]
    | Annotated[BodyCommand, subcommand("body")]
    | Annotated[Config, subcommand("config")]
    | Annotated[Layout, subcommand("layout")]
)
