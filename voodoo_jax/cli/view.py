"""The command `view`: a log and its tracks in a browser."""

from dataclasses import replace

from voodoo_jax.cli.commands import PORTS, View
from voodoo_jax.cli.printing import Stop, stopping, tell


def run_view(command: View) -> int:
    """0 if it was shown until Ctrl-C, 1 if something cannot be read, 2 if nothing could be begun."""
    from voodoo_jax.config.limited import limited
    from voodoo_jax.config.options import Settings, SettingsError
    from voodoo_jax.config.toml import check_settings
    from voodoo_jax.detect.opening import read_log
    from voodoo_jax.exporters.npz import TracksFileError, read_everybody
    from voodoo_jax.io.convert.sources import as_mcap
    from voodoo_jax.io.log_reader import LogError

    if not 1 <= len(command.what) <= 2:
        raise Stop("name a log and, optionally, its tracks: voodoo-jax view LOG [TRACKS]")
    if not 0 <= command.port < PORTS:
        raise Stop(f"--port {command.port}: must be from 0 (any free port) to {PORTS - 1}")
    with stopping(SettingsError):
        check_settings(Settings(read=command.read, limits=command.limits))
    try:
        from voodoo_jax.viz.viewer import Viewer

        with stopping(LogError, SettingsError, TracksFileError, OSError, ValueError, status=1):
            people = read_everybody(command.what[1]) if len(command.what) == 2 else []
            with limited(command.limits), as_mcap(str(command.what[0]), command.read.types) as (log, _):
                viewer = Viewer(read_log(log, replace(command.read, images=True)), people, command.port)
    except ImportError as problem:
        raise Stop('the viewer needs viser: pip install "voodoo_jax[view]"') from problem
    tell(f"Open http://localhost:{viewer.server.get_port()} in a browser; Ctrl-C ends it.", flush=True)
    if not command.once:
        viewer.play()
    viewer.server.stop()
    return 0
