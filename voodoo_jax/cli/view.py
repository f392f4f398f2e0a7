"""The command `view`: a log and its tracks in a browser."""

from dataclasses import replace
from functools import partial

from voodoo_jax.cli import printing
from voodoo_jax.cli.commands import View
from voodoo_jax.cli.printing import tell

say = partial(printing.say, "view")


PORTS = 1 << 16  # of TCP


def run_view(command: View) -> int:
    """0 if it was shown until Ctrl-C, 1 if something cannot be read, 2 if nothing could be begun."""
    from voodoo_jax.config.options import Settings, SettingsError
    from voodoo_jax.config.toml import check_settings
    from voodoo_jax.detect.opening import read_log
    from voodoo_jax.exporters.npz import TracksFileError, read_everybody
    from voodoo_jax.io.convert.in_passing import as_mcap
    from voodoo_jax.io.limits import limited
    from voodoo_jax.io.log_reader import LogError

    if not 1 <= len(command.what) <= 2:
        say("name a log, and its tracks if there are some: voodoo-jax view LOG [TRACKS]")
        return 2
    if not 0 <= command.port < PORTS:
        say(f"--port {command.port}: must be from 0 (any that is free) to {PORTS - 1}")
        return 2
    try:
        check_settings(Settings(read=command.read, limits=command.limits))
    except SettingsError as problem:
        say(problem)
        return 2
    try:
        from voodoo_jax.viz.viewer import Viewer

        people = []
        if len(command.what) == 2:
            people = read_everybody(command.what[1])
        with limited(command.limits), as_mcap(str(command.what[0]), command.read.types) as (log, _):
            viewer = Viewer(read_log(log, replace(command.read, images=True)), people, command.port)
    except ImportError:
        say('it needs viser: pip install "voodoo_jax[view]"')
        return 2
    except (LogError, SettingsError, TracksFileError, OSError, ValueError) as problem:
        say(problem)
        return 1
    tell(f"Open http://localhost:{viewer.server.get_port()} in a browser; Ctrl-C ends it.", flush=True)
    if not command.once:
        viewer.play()
    viewer.server.stop()
    return 0
