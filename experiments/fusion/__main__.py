"""What each kind of measurement gives (Knoop 2007, sec. 7 and Fig. 6): python -m experiments.fusion [RECORDINGS]

Tracks every recording with depth alone, with the rays of 2D features alone, and with both. Rays alone start from pose
and size as depth found them, as the papers' run started from a given pose; after that the points are taken away. Writes
fusion.md (by recording, by group of joints) and fusion.png: inputs as rows, the paper's frames as columns.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.common import (
    DEMO,
    GROUPS,
    Log,
    Score,
    human,
    load_logs,
    mean_row,
    score,
    table,
    without_features,
    write,
)
from voodoo_jax.config.options import Settings
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.viz.figures import draw_body, limb_colours

INPUTS = ("depth", "rays", "fusion")
PAPER_COLUMNS = (5, 50, 81, 120, 129, 144)
PAPER_LENGTH = 150  # frames, about: what the columns of a shorter log are scaled from
TURN = np.radians(40)  # of the view, so that rays are seen as lines


def inputs(log: Log, settings: Settings) -> dict[str, list[BodyObservation]]:
    """The frames with each kind of measurement."""
    seen = np.flatnonzero([len(f.points) > 0 for f in log.people])
    start = (int(seen[0]) if len(seen) else 0) + settings.start.size_frames
    blind = [f.only(np.zeros(len(f.points), bool)) for f in log.people[start:]]
    return {"depth": without_features(log.people), "rays": [*log.people[:start], *blind], "fusion": log.people}


def by_recording(logs: list[Log], scores: dict[str, list[Score]]) -> str:
    """Table of all recordings, and their mean."""
    head, rows = ["recording"], []
    for name in INPUTS:
        head += [f"{name}, cm", "within 10 cm, %", "grade"]
    for i, log in enumerate(logs):
        one = [scores[name][i] for name in INPUTS]
        rows.append([log.name] + [c for s in one for c in (f"{s.error_cm:.2f}", f"{s.within:.1f}", str(s.grade))])
    digits = {"error_cm": 2, "within": 1, "grade": 2}
    cells = [f"{np.mean([getattr(s, k) for s in scores[n]]):.{d}f}" for n in INPUTS for k, d in digits.items()]
    return table(head, [*rows, ["mean", *cells]])


def by_group(scores: dict[str, list[Score]]) -> str:
    """Table of the groups of joints, means over the recordings."""
    rows = []
    for name in INPUTS:
        groups = [f"{np.mean([s.group(group) for s in scores[name]]):.2f}" for group in GROUPS]
        rows.append([name, *groups, mean_row(scores[name])[-1]])
    return table(["input", *(f"{g}, cm" for g in GROUPS), "lost / acceptable / good"], rows)


def columns(log: Log, wanted: tuple[int, ...]) -> list[int]:
    """Frames to draw: the wanted ones, scaled if the log is shorter, and then that of the fastest wrists."""
    scale = 1.0 if len(log.people) > max(wanted) else (len(log.people) - 1) / PAPER_LENGTH
    chosen = [round(scale * k) for k in wanted]
    wrists = log.joints[:, [log.names.index(n) for n in GROUPS["wrists"]]]
    speed = np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max(1)
    later = log.stamps[1:] > log.people[chosen[-1]].time_ns
    if np.nansum(speed[later]) > 0:
        fastest = log.stamps[1:][later][np.nanargmax(speed[later])]
        chosen.append(int(np.abs(np.array([f.time_ns for f in log.people]) - fastest).argmin()))
    return chosen


def draw(
    log: Log, tracks: dict[str, Tracks], people: dict[str, list[BodyObservation]], wanted: tuple[int, ...]
) -> Figure:
    """Rows: the scene's cloud from the sensor, then body, measurements and truth by input, seen from the side."""
    chosen = columns(log, wanted)
    stamps = {log.people[i].time_ns: i for i in chosen}
    clouds = {stamps[f.time_ns]: f.points for f in open_log(log.path).frames() if f.time_ns in stamps}
    up = log.scene.floor.normal.astype(float)
    middle = np.nanmean(log.joints, (0, 1))
    away = middle - log.people[0].origins[0]
    away = (away - (away @ up) * up) / np.linalg.norm(away - (away @ up) * up)
    side = np.cross(away, up)
    turned = np.cos(TURN) * away + np.sin(TURN) * side
    front, slanted = np.stack([side, up, away]), np.stack([np.cross(turned, up), up, turned])
    span = np.nanmax(np.abs((log.joints - middle) @ front.T), (0, 1)) + [0.25, 0.3, 0]

    figure, grid = plt.subplots(4, len(chosen), figsize=(1.5 * len(chosen) + 0.5, 9.2), layout="constrained")
    for column, i in enumerate(chosen):
        seconds = (log.people[i].time_ns - log.people[0].time_ns) / 1e9
        fastest = "\nfastest wrists" if column == len(wanted) else "\n"
        grid[0, column].set_title(f"frame {i}, {seconds:.1f} s{fastest}", fontsize=8)
        cloud = (clouds[i] - middle) @ front.T
        shade = np.argsort(-cloud[:, 2])
        grid[0, column].scatter(
            *cloud[shade, :2].T, s=1.5, c=np.clip(cloud[shade, 2], -0.6, 1.5), cmap="gray", vmax=2, linewidths=0
        )
        for row, name in enumerate(INPUTS, 1):
            _panel(grid[row, column], tracks[name], i, people[name][i], middle, slanted)
            truth = log.joints[np.abs(log.stamps - log.people[i].time_ns).argmin()]
            cross = (truth - middle) @ slanted.T
            grid[row, column].plot(*cross[:, :2].T, "x", color="black", ms=4, mew=0.9, zorder=900, label="true joints")
    for row, what in enumerate(("scene\n(cloud)", "3D data\n(depth)", "2D data\n(rays)", "fusion")):
        grid[row, 0].set_ylabel(f"{what}\nup, m", fontsize=8)
        for panel in grid[row]:
            panel.set(aspect="equal", xlim=(-max(span[0], 0.6), max(span[0], 0.6)), ylim=(-span[1], span[1]))
            panel.tick_params(labelsize=6, labelleft=panel is grid[row, 0], labelbottom=row == 3)
    for panel in grid[3]:
        panel.set_xlabel("right, m", fontsize=8)
    grid[1, 0].plot([], [], "o", color="white", markeredgecolor="black", ms=4, label="tracked joints")
    handles = {t: h for p in grid[1:].flat for h, t in zip(*p.get_legend_handles_labels())}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(f"{log.name}: scene from the sensor, the other rows from 40 degrees aside", fontsize=9)
    return figure


def _panel(panel: Axes, tracks: Tracks, i: int, frame: BodyObservation, middle: np.ndarray, axes: np.ndarray) -> None:
    """Body and measurements of one frame."""
    points = (frame.points - middle) @ axes.T
    if len(points):
        panel.plot(*points[:, :2].T, ".", color="0.35", ms=1.5, mew=0, label="points used", rasterized=True)
    for origin, direction in zip(frame.rays.origins, frame.rays.directions):
        # from the camera to a metre behind the person
        length = np.linalg.norm(middle - origin) + 1.0
        ray = (np.stack([origin, origin + length * direction]) - middle) @ axes.T
        panel.plot(*ray[:, :2].T, "-", color="tab:red", lw=1.0, zorder=950, label="rays of face and hands")
    if np.isfinite(tracks.translation[i]).all():
        colours = limb_colours(tracks.body.topology.limbs)
        draw_body(panel, tracks, i, middle, axes, (0, 1, 2), colours)
    else:
        panel.text(0.5, 0.5, "no pose", transform=panel.transAxes, ha="center", va="center")


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    figure_of: str = "bow-wave-15s",
    frame_numbers: tuple[int, ...] = PAPER_COLUMNS,
    every: int = 1,
    frames: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Depth, rays, fusion.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording (it has no rays).
        figure_of: recording to draw; if it is not there, the first.
        frame_numbers: frames to draw: the paper's.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        out: folder for fusion.md and fusion.png.
    """
    body, settings = human(), Settings()
    logs = load_logs(recordings, body, settings, every, frames)
    drawn = next((log for log in logs if log.name == figure_of), logs[0])
    scores: dict[str, list[Score]] = {name: [] for name in INPUTS}
    figure = None
    for log in tqdm(logs, "track", unit="log", leave=False, disable=None):
        people = inputs(log, settings)
        tracks = {name: log.track(body, settings, people[name]) for name in INPUTS}
        for name in INPUTS:
            scores[name].append(score(log, tracks[name]))
        if log is drawn:
            figure = draw(log, tracks, people, frame_numbers)
    write(out, "fusion", f"{by_recording(logs, scores)}\n{by_group(scores)}", figure, dpi=85)


if __name__ == "__main__":
    tyro.cli(main)
