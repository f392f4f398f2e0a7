"""The recording that comes with the package: replayed, compared with its truth, drawn."""

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from voodoo_jax.records.tracks import Tracks


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
        print("Tracking a simulated person who waves and bows, seen by one depth camera; nothing about them is given.")
        outcome = replay([log], out, again=True)[0]
        tracks = outcome.tracks
        if tracks is None or not outcome.ok:
            return 1
        with np.load(truth_file) as file:
            truth = dict(file)
        errors = joint_errors(tracks, truth)
        print("\nMean distance to the true joint centres:")
        for name, error in zip(truth["names"], np.nanmean(errors, 0)):
            print(f"  {name:16s} {100 * error:5.1f} cm")
        print(f"  {'all joints':16s} {100 * np.nanmean(errors):5.1f} cm")
        print("(The simulated person is made of the tracker's own kind of limbs: on real people expect 2 to 4 cm.)")
        target = Path(out) / "demo.png"
        picture(tracks, read_log(log), target, truth=_on_frames(tracks, truth))
    print(f"\nLook at {target}: cloud and tracked body side by side; crosses are the truth.")
    print(f"In Foxglove open {Path(out) / 'demo.voodoo.mcap'}.")
    return 0


def _on_frames(tracks: Tracks, truth: dict[str, np.ndarray]) -> np.ndarray:
    """The truth's joints at the frames of the tracks (nearest stamp)."""
    return truth["joints"][np.abs(truth["time_ns"][None] - tracks.time_ns[:, None]).argmin(1)].astype(np.float64)
