"""What is a person? python -m experiments.decision BODIES.npz MOTIONS LOG.mcap ...

Fits curves to logs with a truth beside them (the folder that a log is in is its kind), to
scenes and changes of experiments/stress, and to rooms of experiments/rooms with somebody and without. BODIES.npz and
MOTIONS as for experiments/people. Writes decision.json, and decision.md: each kind by what the others have fitted.
"""

import json
from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import human, table, write
from experiments.decision.features import Thing
from experiments.decision.fitting import Table, fitted, least_odds
from experiments.decision.table import Labelled, objects
from experiments.judged import read
from experiments.people.figure import BONES
from experiments.rooms.furnished import Draw, drawn
from experiments.scoreboard.tracked import read_known
from experiments.stress.changes import changes
from experiments.stress.scenes import scenes, shoot
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.opening import open_checked

HEAD = [
    "kind, left out", "people", "other things", *(f"{by}: {what}, %" for by in ("rule", "fit") for what in (
        "people", "other things", "likeliest is a person")),
]  # fmt: skip
UP = np.array([0, 0, 1], np.float32)
NAMES = tuple(name.replace("wrist", "radiocarpal").replace("ankle", "talocrural") for name in BONES)
# somebody is in it; and lies, who is no body of the kind that is looked for: see detect/body_likelihood.py
ROOMS = {"rooms": (True, False), "nobody": (False, False), "lying": (True, True)}
CHANGED = ("bow-active", "guide-happy")  # recordings that are changed as in experiments/stress
UNTRUE = ("scene second person walks behind", "one-and-a-mannequin")  # people, or what looks like them, without a truth


def labelled(bodies: Path, motions: Path, logs: tuple[Path, ...], rooms: int) -> Iterator[Labelled]:
    """All recordings, one by one."""
    for path in logs:
        reader, known = open_checked(path), read_known(path.with_suffix(".truth.npz"))
        joints = known.joints if known.joints.ndim == 4 else known.joints[None]
        yield Labelled(path.parent.name, path.stem, list(reader.frames()), reader.up, known.stamps, known.names, joints)
    settings = Settings()
    some = [read(path, settings) for path in logs if path.stem in CHANGED]
    changed = {(one.name, name): partial(how, one) for one in some for name, how in changes(human(), settings).items()}
    simulated = {("scene", name): partial(lambda n, s: shoot(n, s()), name, scene) for name, scene in scenes().items()}
    for (of, name), made in (*changed.items(), *simulated.items()):
        one = made()
        joints = np.where(one.there[:, None, None], one.joints, np.nan)[None]
        kind = "scenes" if of == "scene" else "changes"
        yield Labelled(kind, f"{of} {name}", one.frames, one.up, one.stamps, one.names, joints)
    for seed, (kind, one) in product(range(rooms), ROOMS.items()):
        shot = drawn(Draw(seed, bodies, motions), *one)
        stamps = np.array([f.time_ns for f in shot.frames])[: None if kind == "rooms" else 0]
        yield Labelled(kind, str(seed), shot.frames, UP, stamps, NAMES, shot.joints[None])


def judged(found: Table, odds: np.ndarray, least: float) -> list[list[str]]:
    """A row for each kind: people and other things that are taken by the rule and by the fit, and looks in which what
    is likeliest of all is a person, of those with one."""
    rows, rule = [], np.array([row.rule for row in found.rows])
    looks = np.unique([f"{row.kind} {row.log} {row.look}" for row in found.rows], return_inverse=True)[1]
    for kind in np.unique(found.kind):
        mine = found.kind == kind
        cells = [str(kind), *(str(np.sum(mine & (found.person == person))) for person in (True, False))]
        for taken, score in ((rule > 0, rule), (odds >= least, odds)):
            for person in (True, False):
                some = mine & (found.person == person)
                cells.append(f"{100 * np.mean(taken[some]):.1f}" if some.any() else "-")
            of = [np.flatnonzero(looks == k) for k in np.unique(looks[mine & found.person])]
            best = [found.person[look[np.argmax(score[look])]] for look in of]
            cells.append(f"{100 * np.mean(best):.1f}" if best else "-")
        rows.append(cells)
    return rows


def main(
    bodies: tyro.conf.Positional[Path],
    motions: tyro.conf.Positional[Path],
    logs: tyro.conf.Positional[tuple[Path, ...]],
    rooms: int = 24,
    out: Path = Path(__file__).parent,
) -> None:
    """Fits what is a person.

    Args:
        bodies: what experiments/people/bodies.py has written.
        motions: folder with humanoid3d_*.txt.
        logs: recordings with a truth.
        rooms: how many rooms are drawn, with somebody and without.
        out: folder for decision.md.
    """
    every = (log for log in labelled(bodies, motions, logs, rooms) if log.name not in UNTRUE)
    found = Table([row for log in tqdm(every, disable=None) for row in objects(log)])
    left_out, fit = found.left_out(), fitted(found)
    least = least_odds(found, left_out)
    curves = {name: [at.tolist(), value.tolist()] for name, at, value in zip(Thing._fields, fit.at, fit.value)}
    write(out, "decision", table(HEAD, judged(found, left_out, least)))
    (out / "decision.json").write_text(json.dumps({"least": least, "curves": curves}, indent=1) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
