"""Learns where joint centres are: python -m experiments.offsets.learn LOGS [LOGS ...]

LOGS: folders with logs of people who are recorded alike, as experiments/people/others.py makes them; each is tracked
with and without features. Left out are people, never logs: the figures printed are of
people nothing was learned from. Writes voodoo_jax/trackers/icp/refine/place_joints.toml.
"""

import textwrap
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import (
    Log,
    human,
    load_dims,
    load_log,
    log_files,
    nearest,
    score,
    scored,
    settings_with,
    without_features,
)
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.refine import place_joints as stage

OUT = Path(stage.__file__).with_name("place_joints.toml")
WORST = 6.0  # cm: logs that are worse are lost in part, and tell nothing of centres
FARTHEST = 0.06  # of the stature: so far off is a limb that is wrong, not a centre
POSE, GAP = 2.0, 40.0  # ridge, of one log: poses and views, bands; chosen on people left out, of 96 logs
HEAD = """\
# Where joint centres are moved to: learned by `python -m experiments.offsets.learn`, see place_joints.py. Rows of
# weights: those of pose_features, then the bands' gaps (x, y, z of each joint).
"""


@dataclass(frozen=True)
class Case:
    """One log: features and shifts of every joint centre."""

    person: str
    folder: str
    scale: float
    gaps: dict[str, stage.Gaps]
    rows: dict[str, tuple[np.ndarray, np.ndarray]]  # centre -> features of the pose, shift over stature


def case(log: Log, tracks: Tracks, person: str, folder: str) -> Case | None:
    """What a tracked log tells; None where the tracks do not allow it."""
    body, eyes = stage.persons_body(tracks.body), stage.sensor_places(log.people)
    if body is None or eyes is None or score(log, tracks).error_cm > WORST:
        return None
    frame, near = nearest(log, tracks)
    use = scored(log) & near & np.isfinite(tracks.joints[frame]).all((1, 2))
    frame, rows = frame[use], {}
    seen = stage.seen_in(body, tracks, frame, eyes)
    for k, name in enumerate(log.names):
        side, plain = stage.plain(name)
        limb = stage.limb_of(body, side, stage.LIMBS[plain][0])
        away = log.joints[use][:, k] - tracks.joints[frame, body.topology.centres.index(name)]
        shift = stage.to_rest(body, tracks, frame, limb, away) / float(body.scale)
        shift *= [1, -1 if side == "r_" else 1, 1]
        rows[name] = stage.pose_features(body, name, tracks, seen), shift
        if not side:  # in the middle: what is so on the left is so on the right
            features = stage.pose_features(body, name, tracks, seen, "r_")
            rows[f"r_{name}"] = features, shift * [1, -1, 1]
    return Case(person, folder, float(body.scale), stage.band_gaps(body, tracks), rows)


def usual_gaps(cases: list[Case], plain: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation over logs."""
    gaps = [stage.gaps_for(plain, c.gaps).gap.ravel() for c in cases]
    return np.nanmean(gaps, 0), np.nanstd(gaps, 0)


def rows_of(one: Case, name: str, told: stage.Learned) -> tuple[np.ndarray, np.ndarray]:
    features, shift = one.rows[name]
    seen = stage.PlaceJoints().gap_features(stage.gaps_for(stage.plain(name)[1], one.gaps), told)
    return np.concatenate([features, np.broadcast_to(seen, (len(features), len(seen)))], 1), shift


def learn(cases: list[Case], plain: str) -> stage.Learned:
    """Ridge regression of a centre's shift; logs count alike."""
    told = stage.Learned(np.zeros((0, 3)), *usual_gaps(cases, plain))
    total: list[np.ndarray] = []
    for one in cases:
        for name in one.rows:
            if stage.plain(name)[1] == plain:
                X, y = rows_of(one, name, told)
                ok = np.linalg.norm(y, axis=1) < FARTHEST
                X, both = X[ok], np.concatenate([X, y], 1)[ok]
                total.append(X.T @ both / max(len(X), 1))
    A = sum(total, np.zeros(total[0].shape))
    gaps = len(told.usual)
    ridge = np.r_[np.full(len(A) - gaps, POSE), np.full(gaps, GAP)]
    return told._replace(weights=np.linalg.solve(A[:, :-3] + np.diag(ridge), A[:, -3:]))


def errors(cases: list[Case], told: dict[str, stage.Learned] | None) -> list[float]:
    """Mean joint error of each log with what was learned, cm."""
    found = []
    for one in cases:
        away = []
        for name, (_, shift) in one.rows.items():
            if told is not None:
                its = told[stage.plain(name)[1]]
                shift = shift - rows_of(one, name, its)[0] @ its.weights
            away.append(100 * one.scale * np.linalg.norm(shift, axis=1).mean())
        found.append(float(np.mean(away)))
    return found


def left_out(cases: list[Case], folds: dict[str, int]) -> list[float]:
    """Errors of the logs of people left out, fold by fold."""
    found = []
    for fold in sorted(set(folds.values())):
        rest = [c for c in cases if folds.get(c.person) != fold]
        found += errors([c for c in cases if folds.get(c.person) == fold], {n: learn(rest, n) for n in stage.LIMBS})
    return found


def toml(told: dict[str, stage.Learned]) -> str:
    lines = [HEAD]
    row = lambda v: "[" + ", ".join(f"{x:.5g}" for x in np.where(np.isfinite(v), v, 0)) + "]"  # noqa: E731
    for name, its in told.items():
        weights = textwrap.fill(", ".join(map(row, its.weights)), 120)
        lines.append(f"[{name}]\nusual = {row(its.usual)}\nspread = {row(its.spread)}\nweights = [\n{weights}\n]\n")
    return "\n".join(lines)


def main(logs: tyro.conf.Positional[list[Path]], out: Path = OUT) -> None:
    """Learns where joint centres are.

    Args:
        logs: folders with *.mcap and *.truth.npz.
        out: file to write.
    """
    body = human()
    settings = settings_with({"track.skip": ("place_joints",), "detect.people": 1})
    cases: list[Case] = []
    for folder in logs:
        for path in tqdm(log_files(folder), folder.name, leave=False, disable=None):
            log = load_log(path, body, settings)
            person = f"{folder.name} {load_dims(path)['stature']:.3f}"
            for people in (log.people, without_features(log.people)):
                one = case(replace(log, people=people), log.track(body, settings, people), person, folder.name)
                cases += [] if one is None else [one]
    for folder in logs:
        some = [c for c in cases if c.folder == folder.name]
        people = sorted({c.person for c in some})
        print(f"{folder.name}: {len(some)} tracks of {len(people)} people")
        print(f"  as tracked {np.mean(errors(some, None)):.3f} cm")
        for name, of in {"each": len(people), "halves": 2}.items():
            folds = {p: k % of for k, p in enumerate(people)}
            print(f"  people left out, {name}: {np.mean(left_out(cases, folds)):.3f} cm")
    out.write_text(toml({name: learn(cases, name) for name in stage.LIMBS}))
    print(f"written: {out}")


if __name__ == "__main__":
    tyro.cli(main)
