"""The command `body`: body files of robots and meshes."""

from voodoo_jax.cli.commands import BodyCommand
from voodoo_jax.cli.printing import Stop, stopping, tell


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
