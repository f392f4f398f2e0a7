"""The commands on files: `convert` recordings of other formats to MCAP logs, `export` tracks to formats of other
programs, make `body` files of robots and meshes, `view` a log and its tracks in a browser."""

from dataclasses import replace
from pathlib import Path

from voodoo_jax.cli.commands import PORTS, BodyCommand, Convert, Export, View
from voodoo_jax.cli.printing import Stop, say, stopping, tell


def run_body(command: BodyCommand) -> int:
    """0 if the body file was written, 1 if the source cannot be used, 2 if nothing could be begun."""
    from voodoo_jax.config.limited import limited
    from voodoo_jax.model.body_file import BodyFileError, write_body
    from voodoo_jax.model.foreign.sources import body_from
    from voodoo_jax.storage.atomic import made_folder

    if command.source is None:
        raise Stop("name a robot description (.urdf) or a skinned mesh (.glb, .gltf)")
    if command.out.exists() and not command.overwrite:
        raise Stop(f"{command.out} exists: name another --out, or add --overwrite")
    pairs = [word.partition("=") for word in command.rest]
    try:
        rest = {name: float(value) for name, _, value in pairs}
    except ValueError as problem:
        raise Stop("--rest: joint values look like elbow=0.5 (radians)") from problem
    with stopping(BodyFileError, OSError, status=1):
        with limited(command.limits):
            body, notes = body_from(command.source, rest, command.least)
        made_folder(command.out.parent)
        write_body(body, command.out)
    tell(f"{command.out}: {body.limb_count} limbs, {body.scale_name} {float(body.scale):.4f} m")
    for note in notes:
        tell(f"    {note}")
    return 0


def run_export(command: Export) -> int:
    """0 if all was written, 1 if something could not be, 2 if nothing could be begun."""
    from voodoo_jax.batch.extra_files import exported_name
    from voodoo_jax.config.limited import limited
    from voodoo_jax.exporters.formats import ExportError, check_formats, export, gaps_note
    from voodoo_jax.exporters.npz import TracksFileError, read_tracks_npz
    from voodoo_jax.storage.atomic import made_folder
    from voodoo_jax.storage.urls import NPZ

    with stopping(ExportError, OSError):
        formats = check_formats([command.formats])
        paths = [path for place in command.tracks for path in _files(place, NPZ)]
        if command.out is not None:
            made_folder(command.out)
    if not paths or not formats:
        raise Stop("name tracks (files <log>.tracks.npz) and formats: voodoo-jax export TRACKS --as csv,bvh")
    failed = False
    for path in paths:
        try:
            with limited(command.limits):
                tracks = read_tracks_npz(path)
        except (TracksFileError, OSError) as problem:
            say("export", problem)
            failed = True
            continue
        for name in formats:
            target = (command.out or path.parent) / exported_name(path, name)
            try:
                tell(export(tracks, target, name, command.style))
            except (ValueError, OSError) as problem:
                say("export", f"{target} could not be written: {problem}")
                failed = True
        if note := gaps_note(tracks, formats):
            tell(f"    {note}")
    return 1 if failed else 0


def _files(place: Path, ending: str) -> list[Path]:
    """The file, or the tracks in a folder and below. Raises OSError."""
    if not place.is_dir():
        return [place]
    if found := sorted(path for path in place.rglob(f"*{ending}") if not path.name.startswith(".")):
        return found
    raise FileNotFoundError(f"there are no tracks (*{ending}) in the folder '{place}'")


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


def run_convert(command: Convert) -> int:
    """0 if all was converted, 1 if something could not be, 2 if nothing could be begun."""
    from voodoo_jax.config.limited import limited
    from voodoo_jax.io.convert.errors import ConvertError
    from voodoo_jax.io.convert.sources import convert
    from voodoo_jax.storage.atomic import made_folder

    if not command.sources or command.out is None:
        raise Stop("name recordings and a log: voodoo-jax convert IN... --out LOG.mcap (a folder for several)")
    single = command.out.suffix == ".mcap"
    if single and len(command.sources) > 1:
        raise Stop(f"{len(command.sources)} recordings need a folder, but --out '{command.out}' is a single log")
    failed = False
    for source in command.sources:
        target = command.out if single else command.out / f"{source.resolve().name}.mcap"
        try:
            made_folder(target.parent)
            if target.exists() and target.samefile(source):
                raise ConvertError(f"--out is the recording '{source}' itself: name another file")
            with limited(command.limits):
                notes = convert(source, target, command.camera, command.rate, command.types)
        except (ConvertError, OSError) as problem:
            say("convert", problem)
            failed = True
            continue
        tell(target)
        for note in notes:
            tell(f"    {note}")
    return 1 if failed else 0
