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

BODY_HELP = (
    "Body to track: human (the default), human10 (the paper's ten limbs), arm, dog, or the path of a body file (TOML)."
)
PRESET_BODIES = {
    "default": "human", "knoop2007": "human10", "flexible": "human", "both": "human", "hecht2009": "human",
}  # fmt: skip
PRESET_HELP = (
    "Settings to start from: default; knoop2007, that paper's chain and values (with its ten limbs); flexible, both: "
    "for these trackers; hecht2009: that paper's values."
)
Preset = Annotated[Literal["default", "knoop2007", "flexible", "both", "hecht2009"], arg(help=PRESET_HELP)]
CONFIG_HELP = "Settings file (TOML), as `voodoo-jax config` prints it; flags override it."

PORTS = 1 << 16  # of TCP
FORMATS_HELP = "Formats: csv, trc, c3d, bvh, bvh-rigid, mot, gltf, usd; several with commas between."
EXPORT_HELP = f"Also write the tracks for other programs. {FORMATS_HELP}"


@dataclass(frozen=True)
class Results(Style):
    """What is written."""

    out: str = "voodoo-out"
    """Folder for the results, or a URL."""
    picture: bool = False
    """Also write <log>.png: image, cloud, tracked body."""
    html: bool = False
    """Also write <log>.html: cloud, bodies, angles and quality over time, for a browser, offline."""
    report: bool = False
    """Also write report.html, with a row for each log."""
    export: Annotated[str, arg(help=EXPORT_HELP)] = ""
    smooth: float = 0.0
    """Average tracks over so many seconds (Gaussian); 0: as tracked."""


@dataclass(frozen=True)
class Running:
    """How many logs are done, where, and at once."""

    again: bool = False
    """Track finished logs anew."""
    verbose: bool = False
    """Print all notes, also in brackets."""
    workers: int = 0
    """Processes that track one log each; 0: as many as there are cores, memory and logs for."""
    shard: str = ""
    """Only a part of the logs, for array jobs, always the same: 2/8 is the second of eight."""
    engine: Literal["local", "batch", "ray"] = "local"
    """local: processes here; batch: many logs at once, for GPUs; ray: a cluster, see RAY_ADDRESS."""
    compile_cache: str = ""
    """Folder of compiled programs, or off; none named: the user's."""
    log_timeout: float = 0.0
    """Seconds after which a log is given up; 0: never."""
    ray_cpus: int = 1
    """Cores that a log holds on Ray."""
    ray_gpus: float = 0.0
    """GPUs that it holds there, 0.25: a share."""
    ray_retries: int = 1
    """Restarts of a log that Ray lost."""


@dataclass(frozen=True)
class Replay:
    """Track people (or other bodies) in recorded logs.

    Writes <log>.tracks.npz (joints, poses, quality) and <log>.voodoo.mcap (for Foxglove), and <log>.2.tracks.npz, ...
    for further people. Usual options: --help; all settings, such as --start.scale: --help-all.
    """

    logs: Positional[tuple[str, ...]] = ()
    """MCAP logs with depth images or point clouds: files, folders of such, or URLs such as s3://bucket/*.mcap."""
    body: Annotated[str, arg(help=BODY_HELP)] = ""
    preset: Preset = "default"
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None
    results: OmitArgPrefixes[Results] = field(default_factory=Results)
    running: OmitArgPrefixes[Running] = field(default_factory=Running)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)


@dataclass(frozen=True)
class Live:
    """Track the main person (or body) during the recording, with the settings of --online.

    Reads an MCAP file, or the folder of a ROS 2 bag, while a recorder writes it, or a Foxglove WebSocket (ws://...,
    such as foxglove_bridge). Publishes transforms and the body frame by frame: in a growing <log>.voodoo.mcap, and with
    --serve as a Foxglove WebSocket. Ends with Ctrl-C or with the recording, and then writes the files of replay. Usual
    options: --help; all settings: --help-all.
    """

    source: Positional[str] = ""
    """A growing .mcap file, the folder of a bag, or ws://HOST:PORT."""
    out: str = "voodoo-out"
    """Folder for the results; made if it is missing."""
    serve: int = -1
    """Port of a Foxglove WebSocket on this machine's own address, for transforms and the body; 0: any free port;
    -1: none."""
    names: Names = ""
    """Names of joints; common: left_wrist."""
    idle: float = 10.0
    """A file that has not grown for so many seconds is finished."""
    body: Annotated[str, arg(help=BODY_HELP)] = ""
    preset: Literal["default", "knoop2007"] = "default"
    """Settings to start from: default; knoop2007, that paper's chain and values (with its body of ten limbs)."""
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None
    compile_cache: str = ""
    """Folder in which compiled programs are kept, or off; none named: the user's cache folder."""
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)


@dataclass(frozen=True)
class UsualSettings(Settings):
    """Settings of which the short help shows only those of no section."""

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
    """Write tracks in formats of other programs: tables, biomechanics, animation.

    What each format holds, with its units and axes, is in docs/results.md.
    """

    tracks: Positional[tuple[Path, ...]] = ()
    """Files <log>.tracks.npz, as replay writes them, or folders of such."""
    formats: Annotated[str, arg(name="as", help=FORMATS_HELP)] = ""
    out: Path | None = None
    """Folder for the files; none named: they are written beside the tracks."""
    style: OmitArgPrefixes[Style] = field(default_factory=Style)
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Convert:
    """Make an MCAP log of a recording of another format.

    ROS 1 bags (.bag), also RealSense's, SQLite bags of ROS 2 (.db3, or their folder), recordings of Azure Kinect and
    Femto cameras (.mkv), skeletons of a Kinect (.json), C3D and TRC, and folders of 16-bit depth images (PNG), as the
    TUM RGB-D benchmark has them or any with a camera file, or of point clouds (PCD, PLY). replay also takes such
    files.
    """

    sources: Positional[tuple[Path, ...]] = ()
    """Recordings: files or folders."""
    out: Path | None = None
    """The log (.mcap) of one recording, or a folder for the logs of several."""
    camera: Path | None = None
    """Camera file (TOML) of depth images, or of an .mkv without calibration: width, height, fx, fy, cx, cy, unit
    (metres of a count), rate (Hz)."""
    rate: float = 0.0
    """Files a second of a folder whose files' names are not times in seconds (or nanoseconds of 19 digits)."""
    types: tuple[str, ...] = ()
    """Definitions of messages (.msg files of their packages) that an SQLite bag lacks; usual drivers' are known."""
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Info:
    """Show the topics of logs, and which of them replay would use."""

    logs: Positional[tuple[Path, ...]]
    """MCAP logs, or folders of them."""
    read: ReadSettings = field(default_factory=ReadSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class View:
    """Show a log and its tracks in a browser: cloud, bodies, markers, camera image with the bodies over it.

    To send somebody a view, use replay --html instead: a file that needs no program.
    """

    what: Positional[tuple[Path, ...]] = ()
    """The log, and <log>.tracks.npz, whose other people (<log>.2.tracks.npz, ...) are shown as well."""
    port: int = 8080
    """Of this machine's own address, on which the browser finds it; the next free one if it is taken."""
    once: bool = False
    """End at once when it is ready: a trial."""
    read: ReadSettings = field(default_factory=ReadSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)


@dataclass(frozen=True)
class Demo:
    """Track the person in the recording that comes with the package, and compare with the truth.

    With --tracker flexible it is a stereo recording, which is simulated first.
    """

    out: Path = Path("demo-out")
    """Folder for the results; made if it is missing."""
    tracker: Literal["icp", "flexible"] = "icp"
    """icp: a depth camera; flexible: a stereo camera's images."""


@dataclass(frozen=True)
class FitCommand:
    """Fit a body's sizes (or joints, bands, weights of measurements) to recorded logs.

    Tracks the logs, changes the body until held-back measurements lie on its surface, and tracks the logs again. The
    body file is written only if the fitted body is better, beyond noise, in time held back from the fit. A report (.md,
    .html, .png) lists the changes with their uncertainty, and why the body was written or not. Parameters that the logs
    do not determine keep their values. Fitted weights of measurements and options of the solve go into a settings file
    (.config.toml) for --config. Use the body with `voodoo-jax replay LOG --body FILE`: replay finds the size anew and
    keeps the proportions. Ctrl-C stops the fit; the same command continues it.
    """

    logs: Positional[tuple[Path, ...]] = ()
    """MCAP logs, or folders of them."""
    out: Path = Path("body.toml")
    """Body file to write if it is better; with several persons -1, -2, ... is added to its name."""
    keep_anyway: bool = False
    """Write the fitted body even if it is no better."""
    truth: tuple[Path, ...] = ()
    """Fit joint centres to these .npz files instead (time_ns, joints, joint_names), one for each log."""
    overwrite: bool = False
    """Replace files that exist."""
    body: Annotated[str, arg(help=BODY_HELP)] = ""
    tracker: Literal["", "icp", "flexible"] = ""
    """icp: fitted to depth; flexible: to the images of stereo or colour and depth cameras. Empty: that of --config."""
    config: Annotated[Path | None, arg(help=CONFIG_HELP)] = None
    fit: Annotated[FitSettings, arg(name="")] = field(default_factory=FitSettings)


@dataclass(frozen=True)
class BodyCommand:
    """Make a body file of a robot description (URDF) or of a skinned mesh (glTF).

    Links, or the parts of the mesh that follow a joint, become limbs: the nearest tapered elliptic cylinders. Notes
    name badly fitting parts. Track with `voodoo-jax replay LOG --body FILE --start.scale N`; this command prints N.
    """

    source: Positional[Path | None] = None
    """A .urdf, .glb or .gltf file."""
    out: Path = Path("body.toml")
    """Body file to write."""
    rest: tuple[str, ...] = ()
    """Values of a robot's joints in its rest pose, such as elbow=0.5, radians; 0 for others. It should not be stretched
    out, nor at the joints' limits."""
    least: float = 0.03
    """Parts smaller than this are one with what they hang on, metres."""
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
    """Print a layout for Foxglove (Layouts, Import from file): body in a 3D panel, confidence and residual below."""


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
