"""`voodoo-jax tune`: logs with truth in, settings of the flexible tracker out, if they are better."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm.auto import tqdm

from voodoo_jax.cli.commands import TuneCommand
from voodoo_jax.cli.demo import RATE
from voodoo_jax.cli.printing import say, tell
from voodoo_jax.config.options import Settings
from voodoo_jax.config.presets import preset
from voodoo_jax.config.toml import settings_text
from voodoo_jax.config.tune_options import check_tune
from voodoo_jax.fitting.flexible_search import Tuned, tune
from voodoo_jax.fitting.frames import TruthError
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.io.limits import limited
from voodoo_jax.io.log_reader import LogError
from voodoo_jax.model.body_file import BodyFileError, load_body
from voodoo_jax.records.notes import shown
from voodoo_jax.storage.atomic import check_writable, made_folder, replacing
from voodoo_jax.storage.urls import expanded
from voodoo_jax.trackers.base import Unsuitable

if TYPE_CHECKING:
    from voodoo_jax.simulate.colour import ColourSimulation


def run_tune(command: TuneCommand, base: Settings) -> int:
    """0 if the search was made, whether it found better settings or not; 1 if it failed, 2 if it could not begin, 130
    if it was interrupted."""
    settings = base if base.tracker == "flexible" else replace(preset(command.preset), limits=base.limits)
    try:
        check_tune(command.tune)
        _check(command)
        made_folder(command.out.parent)
        check_writable(command.out)
        if command.simulate:
            simulated(command.logs[0], command.simulate, settings.flexible.seed)
        logs = [path for place in command.logs for path in expanded(place)]
        truths = command.truth or [Path(log).with_suffix(".truth.npz") for log in logs]
        with limited(settings.limits), tqdm(total=command.tune.evaluations, leave=False, disable=None) as bar:

            def show(what: str, count: int) -> None:
                bar.set_description(shown(what))
                bar.n = count
                bar.refresh()

            found = tune(load_body(command.body or "human"), logs, truths, settings, command.tune, show)
    except KeyboardInterrupt:
        say("tune", "interrupted; nothing was written")
        return 130
    except ModuleNotFoundError as problem:
        if problem.name != "cma":
            raise
        say("tune", 'needs the package cma: pip install -e ".[tune]"')
        return 2
    except (BodyFileError, TruthError, FitError, LogError, Unsuitable, ValueError, OSError) as problem:
        say("tune", problem)
        return 1 if isinstance(problem, (FitError, LogError, Unsuitable)) and command.logs else 2
    tell("\n".join(report(found)))
    if found.better:
        with replacing(command.out) as partial:
            partial.write_text(settings_text(found.found), encoding="utf-8")
        tell(f"written: {command.out}")
    else:
        command.out.unlink(missing_ok=True)  # an older one would be taken for this search's
        tell("No settings are written.")
    return 0


def _check(command: TuneCommand) -> None:
    """Raises ValueError for what cannot be begun."""
    if command.out.suffix != ".toml":
        raise ValueError(f"--out '{command.out}': name a settings file, with the ending .toml")
    if command.out.exists() and not command.overwrite:
        raise ValueError(f"{command.out} exists: name another --out, or say --overwrite")
    if command.simulate < 0 or (command.simulate and (len(command.logs) != 1 or command.logs[0].suffix == ".mcap")):
        raise ValueError("--simulate: name one folder, into which the logs are written")


def report(found: Tuned) -> list[str]:
    """What was found, as lines."""
    before, after = (vars(s.flexible) for s in (found.before, found.found))
    lines = [f"searched on {', '.join(found.chosen_on)}", f"judged on {', '.join(found.judged_on)}"]
    for name, value in after.items():
        if value != before[name]:
            was, now = (
                ", ".join(f"{x:.3g}" for x in (v if isinstance(v, tuple) else (v,))) for v in (before[name], value)
            )
            lines.append(f"  {name}: {was} -> {now}")
    return [*lines, found.why]


def simulated(folder: Path, count: int, seed: int) -> None:
    """Writes simulated stereo logs and their truths into a folder; those that are there stay. Raises OSError."""
    from voodoo_jax.simulate.mcap import write_colour

    made_folder(folder)
    for number in tqdm(range(count), desc="simulating", leave=False, disable=None):
        path = folder / f"simulated-{number:03}.mcap"
        if not path.exists():
            write_colour(somebody(np.random.default_rng([seed, number])), path)


def somebody(rng: np.random.Generator) -> "ColourSimulation":
    """A person of any stature, clothes and room before a stereo camera, who stands and then makes two movements."""
    from voodoo_jax.model.body import scaled
    from voodoo_jax.model.body_file import human
    from voodoo_jax.simulate.colour import simulate_colour
    from voodoo_jax.simulate.looks import random_look, random_scenery
    from voodoo_jax.simulate.motion import make_motion, placed, sequence

    body, look, scenery = scaled(human(), float(rng.uniform(1.6, 1.9))), random_look(rng), random_scenery(rng)
    moves = [("stand", 0.5), *((str(name), 1.6) for name in rng.permutation(["wave", "bow", "walk"])[:2])]
    motion = sequence(*(make_motion(body, name, seconds, RATE) for name, seconds in moves))
    at = placed(
        motion, float(rng.uniform(2.9, 3.4)), float(rng.uniform(-0.2, 0.2)), np.pi + float(rng.uniform(-0.5, 0.5))
    )
    return simulate_colour(body, at, look=look, scenery=scenery)
