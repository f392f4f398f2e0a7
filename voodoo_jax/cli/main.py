"""The command `voodoo-jax`. Nothing heavy is imported before a command runs: `--help` answers at once."""

import atexit
import gc
import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from importlib.resources import files
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro
from tyro.conf import arg

from voodoo_jax.cli.commands import (
    PRESET_BODIES,
    BodyCommand,
    Command,
    Convert,
    Demo,
    Export,
    FitCommand,
    Info,
    Layout,
    Live,
    Replay,
    UsualSettings,
    View,
)
from voodoo_jax.cli.printing import Stop, say, stopping, tell
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.config.output_style import Style
from voodoo_jax.config.presets import PRESETS, preset
from voodoo_jax.config.ray_tasks import RayTasks
from voodoo_jax.config.toml import check_settings, read_settings, settings_text
from voodoo_jax.storage.troubles import WHILE_WRITING, NotWritten

if TYPE_CHECKING:
    from voodoo_jax.batch.outcome import Outcome

ALL_HELP = "--help-all"
# each has a function run_<name>, here or in a module <name> of this package, or in `files`
NAMES = {
    Replay: "replay", Info: "info", Demo: "demo", Live: "live", Export: "export", Convert: "convert", View: "view",
    BodyCommand: "body", FitCommand: "fit",
}  # fmt: skip
APART = ("live", "fit")  # what they import takes long, or is theirs alone
ALL = 1 << 20  # characters of a list of logs: not cut
_T = TypeVar("_T")


def body_name(command: Replay) -> str:
    """The body that the command names, or that of the preset."""
    return command.body or PRESET_BODIES[command.preset]


def run_replay(command: Replay) -> int:
    """0 if every log was tracked, 1 if one failed, 2 if nothing could be begun, 3 if all were but one lost frames to
    damage."""
    if not command.logs:
        raise Stop("name at least one log")
    if command.settings.online and command.results.smooth:
        raise Stop("--smooth uses later frames; leave it out with --online")
    if command.settings.online_lag and (not command.settings.online or command.settings.tracker == "flexible"):
        raise Stop("--online-lag needs --online and a tracker of points; leave it out")
    gc.disable()  # all that is imported stays, and need not be gone through again and again
    from voodoo_jax.batch.replay import NotSummedUp, replay
    from voodoo_jax.compile.cache_dir import CacheError, safe_folder, use_compile_cache
    from voodoo_jax.config.limited import limited
    from voodoo_jax.model.body_file import BodyFileError, load_on_host
    from voodoo_jax.trackers.stages import check_stages

    gc.enable()

    def without_cache(problem: str) -> None:
        say("replay", f"{problem}; continuing without a compile cache")

    with stopping(CacheError):
        cache = safe_folder(command.running.compile_cache, without_cache)
    if problem := use_compile_cache(cache):
        without_cache(problem)
    try:
        unsummed = False
        with limited(command.settings.limits):
            body = load_on_host(body_name(command))
        check_stages(command.settings)
        wanted, how = command.results, command.running
        style = Style(wanted.names, wanted.rig, wanted.pose)
        outcomes = replay(
            command.logs, wanted.out, body, command.settings, smooth_seconds=wanted.smooth, picture=wanted.picture,
            html=wanted.html, report=wanted.report, export=[wanted.export], style=style, again=how.again,
            verbose=how.verbose,
            workers=how.workers, engine=how.engine, shard=how.shard, compile_cache=cache or "off",
            log_timeout=how.log_timeout, ray=RayTasks(how.ray_cpus, how.ray_gpus, how.ray_retries),
        )  # fmt: skip
    except NotSummedUp as problem:
        say("replay", problem)
        outcomes, unsummed = problem.outcomes, True
    except (BodyFileError, ValueError, OSError) as problem:
        if _of_printing(problem):
            raise
        raise Stop(problem) from problem
    return 1 if _summed_up(outcomes, command.results.out) or unsummed else 3 if _damaged(outcomes) else 0


def _summed_up(outcomes: "list[Outcome]", out: str) -> bool:
    """Says what was done; whether a log failed."""
    from voodoo_jax.records.notes import plain

    failed = [o for o in outcomes if not o.ok]
    frames, skipped = sum(o.frames for o in outcomes), sum(o.skipped for o in outcomes)
    before = f" ({skipped} of them finished before)" if skipped else ""
    tell(f"{len(outcomes) - len(failed)} of {len(outcomes)} logs tracked{before}, {frames} frames, results in {out}")
    if failed:
        say("replay", "not tracked: " + ", ".join(plain(o.name) for o in failed), ALL)
    if damaged := _damaged(outcomes):
        say("replay", "damaged, frames are missing: " + ", ".join(plain(o.name) for o in damaged), ALL)
    return bool(failed)


def _damaged(outcomes: "list[Outcome]") -> "list[Outcome]":
    """Logs that were tracked without the frames that damage took."""
    return [o for o in outcomes if o.ok and o.damaged]


def run_info(command: Info) -> int:
    """0 if every log could be read, 1 if one could not, 2 if none was named or found."""
    if not command.logs:
        raise Stop("name at least one log")
    from voodoo_jax.config.limited import limited
    from voodoo_jax.io.log_reader import LogError, survey
    from voodoo_jax.storage.urls import expanded

    status = 0
    with stopping(ValueError):
        check_settings(Settings(read=command.read, limits=command.limits))
        paths = [path for place in command.logs for path in expanded(place)]
    for path in paths:
        try:
            with limited(command.limits):
                found = str(survey(path, command.read))
        except (LogError, SettingsError) as problem:
            say("info", problem)
            status = 1
        except Exception as problem:  # one log's trouble is not the others'
            say("info", f"'{path}': unexpected {type(problem).__name__}: {problem}")
            status = 1
        else:
            tell(found)
    return status


def run_demo(command: Demo) -> int:
    """Replays the shipped recording, or a simulated one; 0 if it was tracked."""
    from voodoo_jax.cli.demo import demo, demo_flexible

    try:
        return (demo if command.tracker == "icp" else demo_flexible)(command.out)
    except (OSError, ValueError) as problem:
        if _of_printing(problem):
            raise
        raise Stop(problem) from problem


def _flag(argv: list[str], name: str) -> str | None:
    """What stands behind a flag that settles the defaults from which --help and the other flags start."""
    for i, word in enumerate(argv):
        if word == name and i + 1 < len(argv):
            return argv[i + 1]
        if word.startswith(name + "="):
            return word.split("=", 1)[1]
    return None


def _parsed(kind: type, name: str, words: list[str], base: Settings) -> Any:
    """What the words after a command's name say, on top of the settings `base`; --help shows the usual ones, --help-all
    all."""
    short = not {ALL_HELP} & set(words) and bool({"-h", "--help"} & set(words))
    shown = UsualSettings(**vars(base)) if short else base

    @dataclass(frozen=True)
    class Configured(kind):
        __doc__ = kind.__doc__
        settings: Annotated[UsualSettings if short else Settings, arg(name="")] = field(  # type: ignore[valid-type]
            default_factory=lambda: shown
        )

    words = ["--help" if word == ALL_HELP else word for word in words]
    return tyro.cli(Configured, prog=f"voodoo-jax {name}", args=words)


def main(argv: list[str] | None = None) -> int:
    """Entry point; the exit status."""
    _open_standard_files()
    argv = sys.argv[1:] if argv is None else argv
    if argv == ["--version"]:
        from voodoo_jax._version import __version__

        tell(f"voodoo-jax {__version__}")
        return 0
    try:
        path, name = _flag(argv, "--config"), _flag(argv, "--preset")
        base = preset(name) if name in PRESETS else Settings()
        base = read_settings(path, base) if path else base
    except SettingsError as problem:
        say("", problem)
        return 2
    except OSError as problem:
        say("", f"cannot read the settings file {path}: {problem.strerror}")
        return 2
    if argv[:1] in (["replay"], ["live"]):
        # NumPy makes no threads then, and workers can be copies of this process; its matrices are small here
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

        name, kind = argv[0], Replay if argv[0] == "replay" else Live
        words = [re.sub("^--online[.]lag", "--online-lag", word) for word in argv[1:]]
        command = _quietly(lambda: _parsed(kind, name, words, base))
        try:
            check_settings(command.settings)
        except SettingsError as problem:
            say(name, problem)
            return 2
    else:
        argv = ["--help" if word == ALL_HELP else word for word in argv]
        command = _quietly(lambda: tyro.cli(Command, prog="voodoo-jax", args=argv or ["--help"]))
    atexit.register(gc.freeze)  # else Python goes through all of it once more at its end: a third of a second
    try:
        return _quietly(lambda: _run(command, base))
    except (KeyboardInterrupt, RuntimeError) as problem:
        # a progress bar that is interrupted as it takes its lock raises RuntimeError while it lets go of it (tqdm)
        if not isinstance(problem, KeyboardInterrupt) and not isinstance(problem.__context__, KeyboardInterrupt):
            raise
        say("", "interrupted; finished logs are complete")
        return 130


def _quietly(do: Callable[[], _T]) -> _T:
    """The result of `do`; ends this process if the reader of its output has closed the pipe, as in `| head -1`."""
    try:
        try:
            return do()
        finally:
            sys.stdout.flush()
    except OSError as problem:
        if not _of_printing(problem):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes it once more at its end
        if isinstance(problem, BrokenPipeError):
            raise SystemExit(141) from None  # 128 + SIGPIPE, as of other commands
        say("", f"the output cannot be written: {problem.strerror}")
        raise SystemExit(1) from None


def _of_printing(problem: Exception) -> bool:
    """Whether an error comes from printing: the reader has closed the pipe, or the output's disk is full."""
    if isinstance(problem, BrokenPipeError):
        return True
    if not isinstance(problem, OSError) or isinstance(problem, NotWritten):
        return False
    return problem.filename is None and problem.errno in WHILE_WRITING


def _open_standard_files() -> None:
    """Opens what the caller has closed of standard input and outputs: else files of ours would get their numbers, and
    what libraries print."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")


def _run(command: Command, base: Settings) -> int:
    own = {Replay: run_replay, Info: run_info, Demo: run_demo}
    for kind, name in NAMES.items():
        if isinstance(command, kind):
            run = own.get(kind) or getattr(
                import_module(f"voodoo_jax.cli.{name if name in APART else 'files'}"), f"run_{name}"
            )
            try:
                return run(command, base) if kind is FitCommand else run(command)
            except Stop as why:
                say(name, why)
                return why.status
    layout = files("voodoo_jax").joinpath("data", "foxglove_layout.json")
    tell((layout.read_text() if isinstance(command, Layout) else settings_text(base)).rstrip("\n"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
