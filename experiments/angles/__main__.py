"""Joint angles beside OpenSim's inverse kinematics: python -m experiments.angles LOG.mcap ... (needs `opensim`)

Each log of markers is tracked, and a model is built of its body: the same limbs and joint centres, the markers where
they were on their limbs (median over the log), joints with the degrees of freedom of usual models. OpenSim's
InverseKinematicsTool then finds that model's coordinates from the markers alone. Writes angles.md and angles.png.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import tyro
from jaxtyping import Float
from matplotlib.figure import Figure

import voodoo_jax as vj
from experiments.angles.model import build, solved
from experiments.common import table, write
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.isb_angles import UPRIGHT, Convention, cardan_zxy, joint_angles
from voodoo_jax.records.tracks import Tracks

SPINE, ARM = ("flexion", "bending", "rotation"), ("flexion", "adduction", "rotation")
# what tracks.angles() says otherwise: an arm's plane, elevation, rotation do not exist where it hangs
CARDAN_ARM = (Convention("arm", ("chest", "torso"), "upper_arm", ARM),)
SHOWN = ("r_hip_flexion", "r_knee_flexion", "r_ankle_dorsiflexion", "trunk_flexion", "r_arm_flexion", "r_elbow_flexion")
ANGLES = (
    "hip_flexion", "hip_adduction", "hip_rotation", "knee_flexion", "ankle_dorsiflexion", "ankle_inversion",
    "trunk_flexion", "trunk_bending", "trunk_rotation", "arm_flexion", "arm_adduction", "arm_rotation",
    "elbow_flexion", "elbow_pronation",
)  # fmt: skip


def markers_of(recording: vj.Recording) -> tuple[list[str], Float[np.ndarray, "frame marker 3"]]:
    """Names and places, metres, fixed frame; NaN where a marker is not seen."""
    names = sorted({n for f in recording for n in f.pairs.names})
    places = np.full((len(recording), len(names), 3), np.nan)
    for k, frame in enumerate(recording):
        places[k, [names.index(n) for n in frame.pairs.names]] = frame.pairs.points
    return names, places


def on_limbs(tracks: Tracks, places: Float[np.ndarray, "frame marker 3"]) -> list[tuple[int, np.ndarray] | None]:
    """The limb on which each marker stays most nearly in one place, and that place, metres; None for those that stay
    nowhere (5 cm), or are seen in less than half of the frames."""
    away = places[None] - tracks.translation.swapaxes(0, 1)[:, :, None]
    turns = np.stack([rotations(tracks.rotation[:, k]).as_matrix() for k in range(tracks.rotation.shape[1])])
    own = np.where(tracks.tracked[None, :, None, None], away @ turns, np.nan)  # [limb, frame, marker, 3]
    found = []
    for m in range(places.shape[1]):
        there = np.isfinite(own[0, :, m, 0])
        if there.mean() < 0.5:
            found.append(None)
            continue
        middle = np.median(own[:, there, m], axis=1)
        spread = np.sqrt(np.mean(np.sum((own[:, there, m] - middle[:, None]) ** 2, -1), axis=1))
        best = int(np.argmin(spread))
        found.append((best, middle[best]) if spread[best] < 0.05 else None)
    return found


def write_trc(path: Path, names: list[str], seconds: np.ndarray, places: Float[np.ndarray, "frame marker 3"]) -> None:
    """Markers, metres, y up."""
    rate = f"{1 / np.median(np.diff(seconds)):.3f}"
    lines = [f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
             "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
             f"{rate}\t{rate}\t{len(seconds)}\t{len(names)}\tm\t{rate}\t1\t{len(seconds)}",
             "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
             "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(len(names)) for axis in "XYZ"), ""]  # fmt: skip
    for k, (t, row) in enumerate(zip(seconds, (places @ UPRIGHT).reshape(len(seconds), -1))):
        lines.append("\t".join([str(k + 1), f"{t:.6f}", *(f"{x:.6f}" if np.isfinite(x) else "NaN" for x in row)]))
    path.write_text("\n".join(lines) + "\n")


def start_of(tracks: Tracks) -> dict[str, float]:
    """Where the pelvis is in the first frame, for OpenSim's first step: it would not find somebody who looks back."""
    first = int(np.flatnonzero(tracks.tracked)[0])
    rest = rotations(np.asarray(tracks.body.rest.rotation)[:1].astype(float))
    turn = (rotations(tracks.rotation[first : first + 1, 0]) * rest.inv()).as_matrix()
    angles = cardan_zxy(UPRIGHT.T @ turn @ UPRIGHT)[0]
    names = [f"pelvis_{n}" for n in ("tilt", "list", "rotation", "tx", "ty", "tz")]
    return dict(zip(names, [*angles.tolist(), *(tracks.translation[first, 0] @ UPRIGHT).tolist()]))


def both(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Each angle of a log over time by OpenSim and by tracks.angles(), degrees."""
    recording = vj.read_log(str(path))
    tracks = vj.track(vj.human(), recording)
    names, places = markers_of(recording)
    at = on_limbs(tracks, places)
    plain = {m: f"m{m}_" + "".join(c if c.isalnum() else "_" for c in names[m]) for m, spot in enumerate(at) if spot}
    seconds = (tracks.time_ns - tracks.time_ns[0]) / 1e9
    with TemporaryDirectory() as folder:
        model, trc = Path(folder) / "model.osim", Path(folder) / "markers.trc"
        build(tracks.body, {plain[m]: spot for m, spot in enumerate(at) if spot is not None}, model)
        write_trc(trc, list(plain.values()), seconds, places[:, list(plain)])
        found = solved(model, trc, start_of(tracks), (float(seconds[0]), float(seconds[-1])))
    ours = tracks.angles()
    arms = joint_angles(tracks.body, tracks.rotation, (tracks.evidence.limb_weight > 0) & tracks.tracked[:, None],
                        conventions=CARDAN_ARM)  # fmt: skip
    out = {}
    for name in (side + n for n in ANGLES for side in (("",) if n.startswith("trunk") else ("l_", "r_"))):
        angle = np.degrees((arms if "_arm_" in name else ours)[name]) - (90 if name.endswith("pronation") else 0)
        out[name] = np.interp(seconds, found["time"], np.unwrap(found[name], period=360)), angle
    print(f"{path.stem}: {len(plain)} of {len(names)} markers, {len(seconds)} frames")
    return out


def apart(opensim: np.ndarray, ours: np.ndarray) -> tuple[float, float]:
    """Mean difference (without whole turns), and the root mean square of what is left without it, degrees."""
    d = (ours - opensim)[np.isfinite(ours - opensim)]
    if not len(d):
        return np.nan, np.nan
    return float((np.mean(d) + 180) % 360 - 180), float(np.std(d))


def main(logs: tyro.conf.Positional[tuple[Path, ...]], out: Path = Path(__file__).parent) -> None:
    """Joint angles beside OpenSim's inverse kinematics.

    Args:
        logs: logs of markers.
        out: folder for angles.md and angles.png.
    """
    found = {path.stem: both(path) for path in logs}
    rows = []
    for angle in ANGLES:
        row = [angle]
        for log in found.values():
            parts = np.array([apart(*log[n]) for n in log if n.removeprefix("l_").removeprefix("r_") == angle])
            reach = [np.nanmax(o) - np.nanmin(o) for n, (o, _) in log.items() if n.endswith(angle)]
            spread, offsets = np.sqrt(np.mean(parts[:, 1] ** 2)), "/".join(f"{x:+.1f}" for x in parts[:, 0])
            row += ["-", "-", "-"] if np.isnan(spread) else [f"{spread:.1f}", offsets, f"{max(reach):.0f}"]
        rows.append(row)
    head = ["degrees", *(t for n in found for t in (f"{n}: r.m.s.", "constant, left/right", "range"))]
    write(out, "angles", table(head, rows), drawn(found))


def drawn(found: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]) -> Figure:
    """Some angles of each log over time, both ways."""
    figure, axes = plt.subplots(len(SHOWN), len(found), figsize=(4 * len(found), 10), squeeze=False, sharex="col",
                                layout="constrained")  # fmt: skip
    for column, (log, angles) in enumerate(found.items()):
        axes[0, column].set_title(log)
        for row, name in enumerate(SHOWN):
            opensim, ours = angles[name]
            axes[row, column].plot(opensim, label="OpenSim")
            axes[row, column].plot(ours, "--", label="tracks.angles()")
            axes[row, column].set_ylabel(f"{name}, degrees", fontsize=8)
    for below in axes[-1]:
        below.set_xlabel("frame")
    axes[0, 0].legend()
    return figure


if __name__ == "__main__":
    tyro.cli(main)
