"""Whether the reader gives what MCAP's conformance files hold: python -m experiments.fuzz.conformance"""

import tempfile
from pathlib import Path

from experiments.fuzz.layouts import Layout, content, layouts, written
from voodoo_jax.io.container import LogFile


def all_layouts() -> list[Layout]:
    """The official ones, and those with chunks in each compression."""
    return [layout for how in ("", "lz4", "zstd") for layout in layouts(how)]


def misread(layout: Layout, folder: Path) -> str:
    """What is wrong with what is read of a file, in words; nothing if all is right."""
    path = folder / "layout.mcap"
    path.write_bytes(written(layout))
    log, known = LogFile(path), content(layout.case)
    found = list(log.messages(lambda schema, channel: True))
    messages = [(m.log_time, m.publish_time, m.sequence, m.data) for _, _, m in found]
    in_order = sorted(known.messages, key=lambda m: m[0]) if "ch" in layout.features else known.messages
    if messages != in_order:
        return f"{len(messages)} messages instead of {len(in_order)}, or others, or in another order"
    if log.damage:
        return f"said to be damaged: {' '.join(log.damage)}"
    schemas = {(s.name, s.encoding, s.data) for s, _, _ in found if s is not None}
    topics = {(c.topic, c.message_encoding) for _, c, _ in found}
    if schemas != ({("Example", "c", b"\x04\x05\x06")} if known.schema else set()):
        return f"other schemas: {schemas}"
    if topics != ({("example", "a" if known.schema else "text")} if known.channel else set()):
        return f"other channels: {topics}"
    told = log.declared
    if (told is not None) != ("st" in layout.features) or told and told != dict.fromkeys(told, len(known.messages)):
        return f"other numbers of messages: {told}"
    return ""


def count_right(folder: Path) -> tuple[int, int]:
    """How many of all files are read right, and how many there are."""
    found = [misread(layout, folder) for layout in all_layouts()]
    return sum(not wrong for wrong in found), len(found)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        print("{} of {} files are read right".format(*count_right(Path(place))))
