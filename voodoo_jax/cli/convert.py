"""The command `convert`: recordings of other formats as MCAP logs."""

from voodoo_jax.cli.commands import Convert
from voodoo_jax.cli.printing import Stop, say, tell


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
