"""The command `convert`: recordings of other formats as MCAP logs."""

from functools import partial

from voodoo_jax.cli import printing
from voodoo_jax.cli.commands import Convert
from voodoo_jax.cli.printing import tell

say = partial(printing.say, "convert")


def run_convert(command: Convert) -> int:
    """0 if all was converted, 1 if something could not be, 2 if nothing could be begun."""
    from voodoo_jax.config.limited import limited
    from voodoo_jax.io.convert.errors import ConvertError
    from voodoo_jax.io.convert.sources import convert
    from voodoo_jax.storage.atomic import made_folder

    if not command.sources or command.out is None:
        say("name recordings and a log: voodoo-jax convert IN... --out LOG.mcap (a folder for several)")
        return 2
    single = command.out.suffix == ".mcap"
    if single and len(command.sources) > 1:
        say(f"{len(command.sources)} recordings need a folder: --out '{command.out}' names one log")
        return 2
    failed = False
    for source in command.sources:
        target = command.out if single else command.out / f"{source.resolve().name}.mcap"
        try:
            made_folder(target.parent)
            if target.exists() and target.samefile(source):
                raise ConvertError(f"'{source}' would be replaced by itself: name another --out")
            with limited(command.limits):
                notes = convert(source, target, command.camera, command.rate, command.types)
        except (ConvertError, OSError) as problem:
            say(problem)
            failed = True
            continue
        tell(target)
        for note in notes:
            tell(f"    {note}")
    return 1 if failed else 0
