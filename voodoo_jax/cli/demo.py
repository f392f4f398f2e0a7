"""The recording that comes with the package, or a simulated stereo one: replayed, compared with its truth, drawn."""

from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voodoo_jax.cli.printing import tell
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing

if TYPE_CHECKING:
    from voodoo_jax.simulate.colour import ColourSimulation

STATURE, RATE = 1.74, 15.0  # metres; pairs per second
PARTS = (("stand", 0.5), ("wave", 1.4), ("bow", 1.1))  # motions and seconds
SHOWN = 5  # frames in the picture


def joint_errors(tracks: Tracks, truth: dict[str, np.ndarray]) -> np.ndarray:
    """Distances [frame, joint] in metres between tracks and truth, for the truth's joints and frames."""
    names = [str(name) for name in truth["names"]]
    order = [tracks.body.topology.centres.index(name) for name in names]
    nearest = np.abs(tracks.time_ns[None] - truth["time_ns"][:, None]).argmin(1)
    return np.linalg.norm(tracks.joints[nearest][:, order] - truth["joints"], axis=-1)


def demo(out: Path) -> int:
    """Replays the shipped recording into `out`, prints joint errors against its truth, writes a picture. 0: tracked."""
    from voodoo_jax.batch.replay import replay
    from voodoo_jax.io.log_reader import read_log
    from voodoo_jax.viz.figures import picture

    with as_file(files("voodoo_jax") / "data") as data:
        log, truth_file = data / "demo.mcap", data / "demo.truth.npz"
        tell("Tracking a simulated person who waves and bows in front of a depth camera, without configuration.")
        outcome = replay([log], out, again=True)[0]
        tracks = outcome.tracks
        if tracks is None or not outcome.ok:
            return 1
        with np.load(truth_file) as file:
            truth = dict(file)
        _print_errors(tracks, truth, "2 to 4 cm")
        target = Path(out) / "demo.png"
        picture(tracks, read_log(log), target, truth=_on_frames(tracks, truth))
    tell(f"\nSee {target}: point cloud and tracked body side by side; crosses are the true joints.")
    tell(f"In Foxglove open {Path(out) / 'demo.voodoo.mcap'}.")
    return 0


def demo_flexible(out: Path) -> int:
    """Simulates a stereo recording in `out`, tracks its images with the flexible tracker, prints joint errors against
    the truth and writes a picture. 0: tracked."""
    from voodoo_jax.batch.replay import replay
    from voodoo_jax.config.presets import preset
    from voodoo_jax.io.log_reader import read_log
    from voodoo_jax.simulate.mcap import write_colour

    out, settings = Path(out), preset("flexible")
    out.mkdir(parents=True, exist_ok=True)
    tell("Simulating stereo images of a person who waves and bows (half a minute).")
    log = write_colour(stereo_demo(), out / "demo-flexible.mcap")
    tell("Tracking the person in these images with masses, springs and particle filters, without configuration.")
    outcome = replay([log], out, settings=settings, again=True)[0]
    tracks = outcome.tracks
    if tracks is None or not outcome.ok:
        return 1
    with np.load(log.with_suffix(".truth.npz")) as file:
        truth = dict(file)
    _print_errors(tracks, truth, "3 to 5 cm")
    target = out / "demo-flexible.png"
    _over_images(tracks, read_log(log, settings.read), target, _on_frames(tracks, truth))
    tell(f"\nSee {target}: the tracked body over the left images; crosses are the true joints.")
    tell(f"In Foxglove open {out / 'demo-flexible.voodoo.mcap'}, and {log} for the images.")
    return 0


def stereo_demo() -> "ColourSimulation":
    """A person of 1.74 m, 2.8 m before a stereo camera, who stands relaxed, waves and bows; the same bits each time."""
    from voodoo_jax.model.body import scaled
    from voodoo_jax.model.body_file import human
    from voodoo_jax.simulate.colour import simulate_colour
    from voodoo_jax.simulate.motion import make_motion, placed, sequence

    body = scaled(human(), STATURE)
    motion = sequence(*(make_motion(body, name, seconds, RATE) for name, seconds in PARTS))
    return simulate_colour(body, placed(motion, 2.8, 0.05, np.pi + 0.1))


def _over_images(tracks: Tracks, recording: Recording, target: Path, truth: np.ndarray) -> None:
    """Writes some frames side by side: the body over the images, the true joints as crosses."""
    import cv2

    from voodoo_jax.records.stretches import spread
    from voodoo_jax.viz.overlay import drawn_over

    stamps = np.array([frame.time_ns for frame in recording])
    shown = []
    for row in spread(len(tracks.time_ns), SHOWN):
        frame = recording.frames[int(np.abs(stamps - tracks.time_ns[row]).argmin())]
        image = drawn_over(frame.pictures[0], [tracks], [int(row)], recording.origin, truth[row])
        margin = image.shape[1] // 5  # the person is in the middle
        shown.append(image[:, margin:-margin])
    with replacing(target) as partial:
        partial.write_bytes(np.asarray(cv2.imencode(".png", np.concatenate(shown, 1))[1]).tobytes())


def _print_errors(tracks: Tracks, truth: dict[str, np.ndarray], real: str) -> None:
    errors = joint_errors(tracks, truth)
    tell("\nMean distance to the true joint centres:")
    for name, error in zip(truth["names"], np.nanmean(errors, 0)):
        tell(f"  {name:16s} {100 * error:5.1f} cm")
    tell(f"  {'all joints':16s} {100 * np.nanmean(errors):5.1f} cm")
    tell(f"(The simulated person has the same limb shapes as the tracker's body: on real people expect {real}.)")


def _on_frames(tracks: Tracks, truth: dict[str, np.ndarray]) -> np.ndarray:
    """The truth's joints at the frames of the tracks (nearest stamp)."""
    return truth["joints"][np.abs(truth["time_ns"][None] - tracks.time_ns[:, None]).argmin(1)].astype(np.float64)
