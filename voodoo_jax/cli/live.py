"""The command `live`: tracks while it is recorded."""

import signal
from contextlib import ExitStack
from functools import partial

from voodoo_jax.cli import printing
from voodoo_jax.cli.commands import PORTS, PRESET_BODIES, Live
from voodoo_jax.cli.printing import Stop, stopping, tell

say = partial(printing.say, "live")


def run_live(command: Live) -> int:
    """0 if a person was tracked, 1 if none was or the source cannot be used, 2 if nothing could be started."""
    from voodoo_jax.compile.cache_dir import CacheError, safe_folder, use_compile_cache
    from voodoo_jax.config.limited import limited
    from voodoo_jax.config.options import SettingsError
    from voodoo_jax.config.presets import online
    from voodoo_jax.io.container import LogError
    from voodoo_jax.io.live.sources import open_source
    from voodoo_jax.model.body_file import BodyFileError, load_on_host
    from voodoo_jax.trackers.stages import check_stages

    if not command.source:
        raise Stop("name a growing .mcap file, the folder of a bag, or a Foxglove WebSocket: ws://localhost:8765")
    if not -1 <= command.serve < PORTS:
        raise Stop(f"--serve {command.serve}: must be a port, 0 (any free port) to {PORTS - 1}")
    if command.idle <= 0:
        raise Stop(f"--idle {command.idle:g}: must be above 0 seconds")
    with stopping(CacheError, BodyFileError, SettingsError, OSError, ValueError):
        cache = safe_folder(command.compile_cache, say)
        if problem := use_compile_cache(cache):
            say(f"{problem}; continuing without a compile cache")
        with limited(command.settings.limits):
            body = load_on_host(command.body or PRESET_BODIES[command.preset])
        settings = online(command.settings)
        check_stages(settings)
        from voodoo_jax.batch.live import LiveJob, track_live
        from voodoo_jax.trackers.base import Unsuitable

        job = LiveJob(command.source, command.out, body, settings, command.names)
    with stopping(LogError, SettingsError, Unsuitable, OSError, status=1), ExitStack() as stack:
        with limited(settings.limits):
            source = open_source(command.source, command.idle)
        stack.callback(source.close)
        publishers = _publishers(command, str(job.targets[1]), stack)
        _end_by_interrupt(source, stack)
        outcome = track_live(job, source, publishers, say, say)
    tell(outcome)
    return 0 if outcome.ok else 1


def _publishers(command: Live, mcap: str, stack: ExitStack) -> list:
    """What frames are given to. Raises OSError."""
    from voodoo_jax.exporters.foxglove import FoxgloveServer, GrowingTracks
    from voodoo_jax.storage.atomic import made_folder

    made_folder(command.out)
    file = GrowingTracks(mcap)
    stack.callback(file.close)
    if command.serve < 0:
        return [file]
    try:
        server = FoxgloveServer(command.serve)
    except ImportError as problem:
        raise Stop('--serve needs foxglove-sdk: pip install "voodoo_jax[live]"') from problem
    stack.callback(server.close)
    say(f"open {server.url} in Foxglove (Open connection, Foxglove WebSocket)")
    return [file, server]


def _end_by_interrupt(source, stack: ExitStack) -> None:
    """The first Ctrl-C ends the source, so that results are written; the second one ends all."""
    before = signal.getsignal(signal.SIGINT)

    def end(number, frame) -> None:
        source.ended = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, end)
    stack.callback(signal.signal, signal.SIGINT, before)
