"""The command `export`: tracks in formats of other programs."""

from pathlib import Path

from voodoo_jax.cli.commands import Export
from voodoo_jax.cli.printing import Stop, say, stopping, tell


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
