"""Learns where joint centres are: python -m experiments.offsets.learn RECORDINGS LOGS [LOGS ...]

LOGS: folders with logs of simulated people, as experiments/people makes them. They tell of bends, views and bands;
where centres are on the average say the recordings alone, for the two kinds do not agree on it. People of the
recordings count alike. Left out are people, never logs: the figures printed are of people nothing was learned from.
Writes voodoo_jax/trackers/icp/refine/place_joints.toml.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import Log, human, load_dims, load_log, log_files, nearest, score, scored, settings_with
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.refine import place_joints as stage

OUT = Path(stage.__file__).with_name("place_joints.toml")
WORST = 6.0  # cm: logs that are worse are lost in part, and tell nothing of centres
FARTHEST = 0.06  # of the stature: so far off is a limb that is wrong, not a centre
COUNT = 3.0  # what the recordings count for, over simulated logs: chosen among 1 and 3
CENTRE, POSE, GAP, FREE = 60.0, 1.0, 30.0, 1e-6  # ridge: means, bends and views, bands, the simulated people's mean
HEAD = """\
# Where joint centres are moved to: learned by `python -m experiments.offsets.learn`, see place_joints.py. Rows of
# weights: 1, direction to the sensor (3), bend (3), squares of the direction (3), then the bands' gaps (x, y, z of
# each joint).
"""


@dataclass(frozen=True)
class Case:
    """One log: features and shifts of every joint centre."""

    person: str
    simulated: bool
    scale: float
    gaps: dict[str, stage.Gaps]
    rows: dict[str, tuple[np.ndarray, np.ndarray]]  # centre -> features of the pose, shift over stature


def case(log: Log, tracks: Tracks, person: str, simulated: bool) -> Case | None:
    """What a tracked log tells; None where the tracks do not allow it."""
    body, eyes = stage.persons_body(tracks.body), stage.sensor_places(log.people)
    if body is None or eyes is None or score(log, tracks).error_cm > WORST:
        return None
    frame, near = nearest(log, tracks)
    use = scored(log) & near & np.isfinite(tracks.joints[frame]).all((1, 2))
    frame, rows = frame[use], {}
    for k, name in enumerate(log.names):
        side, plain = stage.plain(name)
        limb = stage.limb_of(body, side, stage.LIMBS[plain][0])
        away = log.joints[use][:, k] - tracks.joints[frame, body.topology.centres.index(name)]
        shift = stage.to_rest(body, tracks, frame, limb, away) / float(body.scale)
        shift *= [1, -1 if side == "r_" else 1, 1]
        rows[name] = stage.pose_features(body, name, tracks, frame, eyes[frame]), shift
    return Case(person, simulated, float(body.scale), stage.band_gaps(body, tracks), rows)


def usual_gaps(cases: list[Case], plain: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean over people of the recordings, and deviation over all."""
    flat = lambda c: stage.gaps_for(plain, c.gaps).gap.ravel()  # noqa: E731
    return np.nanmean([flat(c) for c in cases if not c.simulated], 0), np.nanstd([flat(c) for c in cases], 0)


def rows_of(one: Case, name: str, told: stage.Learned) -> tuple[np.ndarray, np.ndarray]:
    features, shift = one.rows[name]
    seen = stage.PlaceJoints().gap_features(stage.gaps_for(stage.plain(name)[1], one.gaps), told)
    return np.concatenate([features, np.broadcast_to(seen, (len(features), len(seen)))], 1), shift


def mirrored(count: int) -> np.ndarray:
    """Signs of features under mirroring: sideways directions change theirs, gaps are averaged over both sides."""
    signs = np.ones(count)
    signs[[2, 5, 9]] = -1
    return signs


def learn(cases: list[Case], plain: str) -> stage.Learned:
    """Ridge regression of a centre's shift; simulated people have a mean of their own, which is dropped."""
    names = [n for n in cases[0].rows if stage.plain(n)[1] == plain]
    told = stage.Learned(np.zeros((0, 3)), *usual_gaps(cases, plain))
    persons = [c.person for c in cases]
    A = b = count = 0
    for one in cases:
        weight = 1.0 if one.simulated else COUNT * 2 / persons.count(one.person)
        for name in names:
            X, y = rows_of(one, name, told)
            if name == plain:  # in the middle: what is so on the left is so on the right
                X, y = np.concatenate([X, X * mirrored(X.shape[1])]), np.concatenate([y, y * [1, -1, 1]])
            ok = np.linalg.norm(y, axis=1) < FARTHEST
            X, y = np.concatenate([X, np.full((len(X), 1), float(one.simulated))], 1)[ok], y[ok]
            share = weight / max(len(X), 1)
            A, b = A + share * X.T @ X, b + share * X.T @ y
            if not one.simulated:
                count = count + share * X.sum(0)
    assert isinstance(A, np.ndarray) and isinstance(b, np.ndarray) and isinstance(count, np.ndarray)
    centred = np.eye(len(A))  # around the recordings' mean: only there is their mean held
    centred[1:-1, 0] = -(count / count[0])[1:-1]
    ridge = np.r_[CENTRE, np.full(9, POSE), np.full(len(A) - 11, GAP), FREE]
    weights = centred.T @ np.linalg.solve(centred @ A @ centred.T + np.diag(ridge), centred @ b)
    return told._replace(weights=weights[:-1])


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
        weights = "".join(f"  {row(line)},\n" for line in its.weights)
        lines.append(f"[{name}]\nusual = {row(its.usual)}\nspread = {row(its.spread)}\nweights = [\n{weights}]\n")
    return "\n".join(lines)


def main(recordings: tyro.conf.Positional[Path], logs: tyro.conf.Positional[list[Path]], out: Path = OUT) -> None:
    """Learns where joint centres are.

    Args:
        recordings: folder with *.mcap and *.truth.npz.
        logs: folders with logs of simulated people.
        out: file to write.
    """
    body = human()
    settings = settings_with({"track.skip": ("place_joints",), "detect.people": 1})
    cases: list[Case] = []
    for folder in (recordings, *logs):
        for path in tqdm(log_files(folder), folder.name, leave=False, disable=None):
            log, simulated = load_log(path, body, settings), folder != recordings
            person = f"{folder.name} {load_dims(path)['stature']:.3f}"
            one = case(log, log.track(body, settings), person, simulated)
            cases += [] if one is None else [one]
    for simulated in (False, True):
        some = [c for c in cases if c.simulated == simulated]
        people = sorted({c.person for c in some})
        rows = {"each": {p: k for k, p in enumerate(people)}, "halves": {p: k % 2 for k, p in enumerate(people)}}
        print(f"{'simulated' if simulated else 'recordings'}: {len(some)} logs of {len(people)} people")
        print(f"  as tracked {np.mean(errors(some, None)):.3f} cm")
        for name, folds in rows.items():
            if name == "halves" or not simulated:
                print(f"  people left out, {name}: {np.mean(left_out(cases, folds)):.3f} cm")
    out.write_text(toml({name: learn(cases, name) for name in stage.LIMBS}))
    print(f"written: {out}")


if __name__ == "__main__":
    tyro.cli(main)
