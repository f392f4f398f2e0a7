"""`voodoo-jax fit`: logs in, a report and, if it is better, a body file out."""

from dataclasses import replace
from pathlib import Path

from tqdm.auto import tqdm

from voodoo_jax.cli.commands import FitCommand
from voodoo_jax.cli.printing import Stop, say, stopping, tell
from voodoo_jax.config.fit_options import check_fit
from voodoo_jax.config.limited import limited
from voodoo_jax.config.options import Settings
from voodoo_jax.config.toml import settings_text
from voodoo_jax.fitting.checkpoint import Progress
from voodoo_jax.fitting.frames import TruthError
from voodoo_jax.fitting.front import fit
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.fitting.result import Fit, write_report
from voodoo_jax.io.log_reader import LogError
from voodoo_jax.model.body_file import BodyFileError, load_body, write_body
from voodoo_jax.records.notes import shown
from voodoo_jax.storage.atomic import check_writable, made_folder, replacing
from voodoo_jax.storage.urls import expanded


def outputs(out: Path, persons: int) -> list[Path]:
    """The body files that a fit writes."""
    return [out] if persons == 1 else [out.with_name(f"{out.stem}-{k}{out.suffix}") for k in range(1, persons + 1)]


def run_fit(command: FitCommand, settings: Settings) -> int:
    """0 if the fit was made, whether it found a better body or not; 1 if it failed, 2 if it could not begin, 130 if it
    was interrupted."""
    settings = replace(settings, tracker=command.tracker) if command.tracker else settings
    with stopping(ValueError):
        logs = [path for place in command.logs for path in expanded(place)]
    bodies = outputs(command.out, 1 if command.fit.persons == "one" or command.fit.folds else len(logs))
    report, state = command.out.with_suffix(".md"), command.out.with_name(f".{command.out.name}.fit-state.npz")
    config = command.out.with_suffix(".config.toml")
    there = [
        p for p in (*bodies, report, report.with_suffix(".png"), report.with_suffix(".html"), config) if p.exists()
    ]
    if command.out.suffix != ".toml":
        raise Stop(f"--out '{command.out}': must be a body file (.toml)")
    if there and not command.overwrite:
        raise Stop(f"{there[0]} exists: name another --out, or add --overwrite")
    with tqdm(total=command.fit.iterations * command.fit.rounds, unit="step", leave=False, disable=None) as bar:

        def show(what: str, progress: Progress | None) -> None:
            bar.set_description(shown(what))
            if progress is not None:
                bar.n = progress.step
                bar.set_postfix(loss=f"{progress.losses[-1]:.2f}" if progress.losses else "compiling")
                bar.refresh()

        try:
            check_fit(command.fit)
            made_folder(command.out.parent)
            for path in (bodies[0], report, state):
                check_writable(path)
            with limited(settings.limits):
                body = load_body(command.body or "human")
                found = fit(body, logs, settings, command.fit, command.truth, state=state, say=show)
        except KeyboardInterrupt:
            say("fit", "interrupted; the same command continues from the last step")
            return 130
        except (BodyFileError, TruthError, FitError, LogError, ValueError, OSError) as problem:
            raise Stop(problem, 1 if isinstance(problem, (FitError, LogError)) and logs else 2) from problem
    try:
        files = _write(command, settings, found, bodies)
        state.unlink(missing_ok=True)
    except OSError as problem:
        raise Stop(f"{problem}; {state} keeps the fitted parameters", 1) from problem
    tell(found.verdict.why)
    if not found.better:
        kept = "The fitted body is written anyway."
        tell(kept if command.keep_anyway else "No body is written; --keep-anyway writes it.")
    tell(f"written: {', '.join(map(str, files))}")
    return 0


def _write(command: FitCommand, settings: Settings, found: Fit, bodies: list[Path]) -> list[Path]:
    """Writes the report and, if the body is better or `--keep-anyway` is set, body and settings. Returns the paths.
    Raises OSError."""
    config = command.out.with_suffix(".config.toml")
    files = list(write_report(found, command.out.with_suffix(".md")))
    written = found.better or command.keep_anyway
    if written:
        for fitted, path in zip(found.fitted, bodies):
            write_body(fitted, path)
        files = [*bodies, *files]
    else:
        # an older fit's file beside a report that says otherwise would be taken for this one's
        for path in (*bodies, config):
            path.unlink(missing_ok=True)
    if written and found.tuned != settings:
        with replacing(config) as partial:
            partial.write_text(settings_text(found.tuned), encoding="utf-8")
        files.append(config)
    return files
