"""What each ingredient of the flexible tracker gives: python -m experiments.flexible RECORDINGS

RECORDINGS is a folder of stereo (or colour and depth) logs with a *.truth.npz beside each. Each log is read once, then
tracked with every variant and seed. Writes flexible.md.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.config.options import FlexibleSettings
from voodoo_jax.config.presets import preset
from voodoo_jax.detect.pipeline import find_people
from voodoo_jax.fitting.frames import Truth, read_truth
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task, source_of_log
from voodoo_jax.trackers.both.merge import merged
from voodoo_jax.trackers.flexible.observed import Observed, Watching, observe
from voodoo_jax.trackers.flexible.tracker import follow
from voodoo_jax.trackers.of_points import PointTracker

SKIP = 0.5  # seconds of each recording that are not scored
VARIANTS: dict[str, dict] = {
    "flexible": {},
    "no refinement": dict(refine=0),
    "no points in the weights": dict(points_weight=0.0),
    "no depth in the weights": dict(depth_weight=0.0),
    "one layer": dict(layers=1),
    "two layers": dict(layers=2),
    "no second pass": dict(backwards=False),
    "no skin": dict(skin_weight=0.0),
    "no edges, no colours": dict(edge_weight=0.0, surface_weight=0.0),
    "no gravity": dict(gravity=0.0),
    "legs that never cross": dict(legs_cross=0.0),
    "no velocity": dict(velocity=0.0),
    "the paper's depth noise": dict(depth_noise=(0.15, 0.5, 1.0)),
    "80 % of the head's motion": dict(follow_level=0.8, follow_up=0.8),
    "one body": dict(hypotheses=1),
    "8 bodies": dict(hypotheses=8),
    "50 particles": dict(particles=50),
    "100 particles": dict(particles=100),
}
# on which settings and joint offsets were chosen
CHOSEN_ON = ("stereo-bow-active", "stereo-guide-active", "stereo-call", "stereo-walk-right", "stereo-bow-wave")
PAPER: dict[str, dict] = {"hecht2009": {}, "hecht2009, by the seen length": dict(seen_length=True)}


TOGETHER: dict[str, Literal["fine", "none"]] = {"as ICP reads pairs": "fine", "as flexible reads pairs": "none"}


def together(path: Path, truth: Truth, matching: Literal["fine", "none"], seeds: int) -> dict[str, list[np.ndarray]]:
    """Errors of a log by tracker, and of both together; each reads and finds the person once."""
    settings, body = preset("both"), load_body("human")
    log = open_log(path, replace(settings.read, matching=matching))
    source, watching = source_of_log(log), Watching(settings, log.path, given=True)
    people = find_people(watching(log.frames()), log.up, body, settings, log.up_is_given)
    frames = people[0].frames
    seen = watching.observed([frames[row] for row in watching.rows], people[0].scene)
    icp = PointTracker().follow(Task(body, source, settings), people)[0]
    out: dict[str, list[np.ndarray]] = {"icp": [errors(icp, truth)], "flexible": [], "both": []}
    for seed in range(seeds):
        own = replace(settings, flexible=replace(settings.flexible, seed=seed))
        flexible = follow(body, seen, own, log.path, log.fixed_frame)
        both = merged(icp, flexible, frames, settings.track.lost_confidence, settings.track.chunk)
        out["flexible"].append(errors(flexible, truth))
        out["both"].append(errors(both, truth))
    seen.close()
    return {name: found * (seeds // len(found)) for name, found in out.items()}


def errors(tracks: Tracks, truth: Truth) -> np.ndarray:
    """Distances [time, joint] in metres at the truth's stamps; 1 m where there is no answer."""
    names = list(tracks.body.topology.centres)
    order = [names.index(name) for name in truth.names]
    at = np.abs(tracks.time_ns[None] - truth.time_ns[:, None]).argmin(1)
    off = np.linalg.norm(tracks.joints[at][:, order] - truth.joints, axis=-1)
    off = np.where(np.isfinite(off), off, 1.0)
    return off[truth.time_ns >= truth.time_ns[0] + int(SKIP * 1e9)]


def row(name: str, found: dict[str, list[np.ndarray]]) -> str:
    """A line of the table: mean over recordings and share of joints within 10 cm, both with their spread over seeds; of
    those on which settings were chosen, and of the others; each recording."""

    def over(of: Callable[[np.ndarray], float], names: list[str]) -> str:
        by_seed = 100 * np.mean([[of(each) for each in found[name]] for name in names], 0) if names else np.array([])
        return f"{by_seed.mean():.2f} +- {by_seed.std():.2f}" if names else "-"

    mean, within = (lambda e: float(e.mean())), (lambda e: float((e < 0.1).mean()))
    halves = [[name for name in found if (name in CHOSEN_ON) == chosen] for chosen in (True, False)]
    parts = [*(over(mean, half) for half in halves), *(over(within, half) for half in halves)]
    each = ", ".join(f"{100 * np.mean([e.mean() for e in seeds]):.1f}" for seeds in found.values())
    return f"| {name} | {over(mean, list(found))} | {over(within, list(found))} | {' | '.join(parts)} | {each} |"


def _trackers(path: Path, truth: Truth, seeds: int) -> Iterator[tuple[str, list[np.ndarray]]]:
    for way, matching in TOGETHER.items():
        for name, each in together(path, truth, matching, seeds).items():
            yield f"{name}, {way}", each


def _variants(path: Path, truth: Truth, seeds: int, only: str, paper: bool) -> Iterator[tuple[str, list[np.ndarray]]]:
    """Errors of a log by variant, of each seed."""
    settings, variants = preset("hecht2009" if paper else "flexible"), PAPER if paper else VARIANTS
    body, log = load_body("human"), open_log(path, settings.read)
    seen: Observed = observe(log.frames(), log.up, body, settings, log.path)
    for name in (name for name in variants if fnmatch(name, only)):
        found = []
        for seed in range(seeds):
            own: FlexibleSettings = replace(settings.flexible, seed=seed, **variants[name])
            tracks = follow(body, seen, replace(settings, flexible=own), log.path, log.fixed_frame)
            found.append(errors(tracks, truth))
        yield name, found
    seen.close()


@users_cache()
def main(  # 8 parameters: the command's flags
    recordings: tyro.conf.Positional[Path],
    only: str = "*",
    logs: str = "*",
    seeds: int = 5,
    paper: bool = False,
    trackers: bool = False,
    out: Path = Path(__file__).parent,
) -> None:
    """Error of the flexible tracker by ingredient.

    Args:
        recordings: folder with *.mcap and *.truth.npz.
        only: variants whose name matches this pattern.
        logs: recordings whose name matches this pattern.
        seeds: how many seeds.
        paper: variants of the preset hecht2009 instead.
        trackers: the ICP tracker, the flexible one and both together instead, with pairs read as either of them does.
        out: folder for flexible.md.
    """
    paths = sorted(recordings.glob(f"{logs}.mcap"))
    truths = {path: read_truth(path.with_name(f"{path.stem}.truth.npz")) for path in paths}
    tables: dict[str, dict[str, list[np.ndarray]]] = {}
    for path in paths:
        found = _trackers(path, truths[path], seeds) if trackers else _variants(path, truths[path], seeds, only, paper)
        for name, each in found:
            tables.setdefault(name, {})[path.stem] = each
            print(path.stem, row(name, {path.stem: each}), flush=True)
    head = f"| {len(paths)} recordings, {seeds} seeds | mean error, cm | within 10 cm, % | mean, settings chosen on | "
    head += "mean, others | within, settings chosen on | within, others | each recording, cm |"
    lines = [head, "|---" * 8 + "|", *(row(name, found) for name, found in tables.items() if found)]
    out.mkdir(parents=True, exist_ok=True)
    (out / "flexible.md").write_text("\n".join(["# The flexible tracker by ingredient", "", *lines, ""]))


if __name__ == "__main__":
    tyro.cli(main)
