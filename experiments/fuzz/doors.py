"""What damaged and hostile files do at the doors other than MCAP: python -m experiments.fuzz.doors [--count 2000]

convert: recordings of other formats; body: robots and meshes; live: what a server says; results: tracks and summaries
that are read back; pages: names in reports and views. Inputs are sound files of a few kB of which a seed changes what
their formats have: numbers, lengths, names, records, tables, and now and then bits. Ends with 1 if one did harm.
"""

import json
import os
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import tyro

from experiments.common import table
from experiments.fuzz.sound_files import CANARY, Sound, sound_files
from voodoo_jax.config.limited import limited
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.records.notes import SENTENCE, plain, shown
from voodoo_jax.storage import guard

Door = Literal["convert", "body", "live", "results", "pages"]
DOORS: tuple[Door, ...] = ("convert", "body", "live", "results", "pages")
SECONDS, PEAK = 60, 2 << 30  # docs/limits.md
ALLOWED = LimitSettings(seconds=5.0)  # for the limit is tried time and again
NUMBERS = (-1, 0, 1, 2, 7, 255, 256, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**53, 2**63 - 1, 2**64 - 1, -(2**31), 10**9)
WORDS = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1",
    "0",
    "x",
    "\x1b[31mred\x1b[0m",
    "../../secret",
    "/dev/zero",
    "\u202e",
    "a" * 3000,
)
TREES: tuple[Any, ...] = (*NUMBERS, *WORDS, None, True, 0.5, float("inf"), [], {}, [[[]]], {"a": {"a": 1}}, [0] * 5000)


class Tried(NamedTuple):
    """One input and what came of it."""

    door: str
    name: str
    refused: str  # the sentence, if nothing was made of it
    harm: tuple[str, ...]
    seconds: float  # of the processor
    peak: float  # bytes


# -- changes


def changed_bytes(data: bytes, rng: random.Random, at: list[int] | None = None) -> bytes:
    """One to three changes: numbers at places where the format has some (or near the beginning), bits, cuts, blocks."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if not out:
            break
        kind, place = (
            rng.randrange(8),
            rng.randrange(len(out)) if rng.random() < 0.5 else rng.randrange(min(len(out), 1024)),
        )
        if at and rng.random() < 0.7:
            place = min(rng.choice(at), len(out) - 1)
        if kind < 3:
            size = rng.choice((1, 2, 4, 4, 8))
            out[place : place + size] = (rng.choice(NUMBERS) % (1 << 8 * size)).to_bytes(
                size, rng.choice(("little", "big"))
            )
        elif kind == 3:
            out[place] ^= 1 << rng.randrange(8)
        elif kind == 4:
            del out[place:]
        elif kind == 5:
            del out[place : place + rng.choice((1, 4, 64))]
        elif kind == 6:
            out[place:place] = out[place : place + rng.choice((4, 64, 512))]
        else:
            out[place : place + 16] = bytes(16) if rng.random() < 0.5 else b"\xff" * 16
    return bytes(out)


def changed_text(text: str, rng: random.Random) -> str:
    """Words, numbers or lines that are others, twice there or gone."""
    parts = re.split(r"(\s+|[<>\"'=,])", text)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not parts:
            break
        k = rng.randrange(len(parts))
        words = [i for i, part in enumerate(parts) if part.strip() and part not in "<>\"'=,"]
        k = rng.choice(words) if words and rng.random() < 0.9 else k
        kind = rng.randrange(6)
        if kind < 3:
            parts[k] = str(rng.choice(WORDS if kind else NUMBERS))
        elif kind == 3:
            parts[k : k + 1] = []
        elif kind == 4:
            parts[k:k] = parts[k : k + rng.choice((1, 20, 200))] * rng.choice((1, 50))
        else:
            parts[k:] = parts[k : k + 1]
    return "".join(parts)


def changed_tree(tree: Any, rng: random.Random) -> Any:
    """A tree of JSON with some values, keys or lengths that are others."""
    tree = json.loads(json.dumps(tree))
    for _ in range(rng.choice((1, 1, 2, 3))):
        node, key = tree, cast(Any, None)
        while True:
            inside = list(node) if isinstance(node, dict) else range(len(node))
            if not inside:
                break
            key = rng.choice(list(inside))
            if not isinstance(node[key], (dict, list)) or rng.random() < 0.15:
                break
            node = node[key]
        if key is None or key not in node if isinstance(node, dict) else not node:
            continue
        if rng.random() < 0.15:
            del node[key]
        elif isinstance(node, list) and rng.random() < 0.1:
            node *= rng.choice((0, 2, 100))
        else:
            node[key] = rng.choice(TREES)
    return tree


def changed(one: Sound, rng: random.Random, folder: Path) -> Path:
    """Writes a changed copy; the path of what a door is given."""
    folder.mkdir(parents=True)
    victim = rng.choice(sorted(one.files))
    for name, content in one.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        data = content
        if name == victim:
            if isinstance(content, bytes):
                data = changed_bytes(content, rng, one.places)
            elif isinstance(content, str):
                data = changed_text(content, rng)
            else:
                data = json.dumps(changed_tree(content, rng))
        elif not isinstance(content, (str, bytes)):
            data = json.dumps(content)
        path.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass"))
    if one.twist is not None and rng.random() < 0.3:
        one.twist(folder, rng)
    return folder / one.main if one.main else folder


# -- doors: each gives a function that tries an input, and returns (refusal, what was made as text and bytes)

Made = tuple[str, list[str], bytes]


def _convert(source: Path, out: Path, one: Sound) -> Made:
    from mcap.reader import make_reader

    from voodoo_jax.io.convert.errors import ConvertError
    from voodoo_jax.io.convert.sources import convert

    try:
        camera = source.parent / "camera.toml"
        notes = convert(source, out / "x.mcap", camera if one.camera and camera.exists() else None, one.rate)
    except (ConvertError, OSError) as problem:
        return str(problem), [], b""
    with open(out / "x.mcap", "rb") as stream:
        found = [(c.topic, m.data) for _, c, m in make_reader(stream).iter_messages()]
    # topics of a log are cleaned where it is read
    return "", notes, b"".join(data for _, data in found)


def _body(source: Path, out: Path, one: Sound) -> Made:
    from voodoo_jax.model.body_file import BodyFileError, format_body
    from voodoo_jax.model.foreign.sources import body_from

    try:
        body, notes = body_from(source, least=one.least)
    except BodyFileError as problem:
        return plain(str(problem), SENTENCE), [], b""  # as the command says it
    return "", [shown(note) for note in notes], format_body(body).encode()


class _Said(list[Any]):
    """A connection over which all of a tree is said."""

    def __init__(self, tree: Any):
        super().__init__(_message(one) for one in (tree if isinstance(tree, list) else [tree]))

    def send(self, text: str) -> None:
        """Nobody listens."""

    def close(self) -> None:
        """There is nothing to close."""


def _message(one: Any) -> str | bytes:
    if isinstance(one, dict) and isinstance(one.get("data"), str):
        try:
            return bytes.fromhex(one["data"])
        except ValueError:
            return one["data"].encode()
    return json.dumps(one)


def _live(source: Path, out: Path, one: Sound) -> Made:
    from voodoo_jax.config.options import Settings
    from voodoo_jax.detect.opening import open_checked
    from voodoo_jax.detect.pipeline import build_of
    from voodoo_jax.io.container import LogError
    from voodoo_jax.io.live.frames import LiveLog
    from voodoo_jax.io.live.sources import FoxgloveClient
    from voodoo_jax.model.body_file import load_on_host

    if one.main.endswith(".mcap"):
        from voodoo_jax.io.live.sources import GrowingFile

        try:
            client: Any = GrowingFile(str(source), 0.01)
        except LogError as problem:
            return str(problem), [], b""
    else:
        client = FoxgloveClient("ws://nowhere", _Said(json.loads(source.read_text())))
    build = build_of(load_on_host("human"), 0.0)
    settings = Settings()
    log = LiveLog(client, settings.read, lambda held, read: open_checked(held, read, build, settings.detect))
    try:
        log.open()
        count = sum(1 for _ in log.frames())
    except LogError as problem:
        return str(problem), list(client.notes), b""
    finally:
        client.close()
    return "", [str(count), *log.notes], b""


def _results(source: Path, out: Path, one: Sound) -> Made:
    from voodoo_jax.batch.outcome import outcome_of_arrays
    from voodoo_jax.batch.report import write_report
    from voodoo_jax.exporters.npz import TracksFileError, read_tracks_npz, tracks_arrays

    if one.main.endswith(".jsonl"):
        text = Path(write_report(str(source.parent), source.name)).read_text(encoding="utf-8")
        return "", [], text.encode()
    try:
        with open(source, "rb") as stream:
            told = str(outcome_of_arrays("x.mcap", str(source), tracks_arrays(stream, source)))
        tracks = read_tracks_npz(source)
    except (TracksFileError, OSError, KeyError) as problem:
        return plain(str(problem), SENTENCE), [], b""
    from voodoo_jax.exporters.formats import export

    export(tracks, out / "x.csv")
    return "", shown(told).split("\n"), b""


def _pages(source: Path, out: Path, one: Sound) -> Made:
    from voodoo_jax.exporters.npz import read_tracks_npz
    from voodoo_jax.viz.html_view import write_html
    from voodoo_jax.viz.report_page import Row, person_cells, write_report_page

    words = json.loads(source.read_text()).get("words")
    words = [str(word)[:3000] for word in words] if isinstance(words, list) and words else ["x"]
    tracks = replace(read_tracks_npz(one.beside), source=words[0], notes=tuple(words))
    row = Row(words[-1], "tracked", words[0], (("tracks", words[-1]),), (person_cells(tracks),))
    sizes = []
    for path in (write_report_page([row], out / "r.html", words[0]), write_html([tracks], [], out / "v.html")):
        text = path.read_text(encoding="utf-8", errors="surrogatepass")
        sizes.append(len(text))
        markup = re.sub(r'(?s)<script id="blob".*', "", text).replace("\\u003c", "")
        for word in set(words):
            if "<" in word and word in markup:
                raise AssertionError(f"markup of a name in a page: {word[:50]}")
    assert max(sizes) < 400_000 + 40 * sum(map(len, words)), f"pages of {sizes} characters"
    return "", [], b""


TRY: dict[str, Callable[[Path, Path, Sound], Made]] = {
    "convert": _convert, "body": _body, "live": _live, "results": _results, "pages": _pages,
}  # fmt: skip

# -- judging

_events: list[str] = []


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if event in ("socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system"):
        _events.append(f"{event} {str(arguments[1:2])[:80]}")


def tried(door: Door, count: int, seed: int, only: str = "", allowed: LimitSettings = ALLOWED) -> Iterator[Tried]:
    """So many inputs at one door, by chance, with these limits."""
    if not getattr(tried, "watched", False):
        sys.addaudithook(_watch)
        tried.watched = True  # type: ignore[attr-defined]
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        (root / "secret").write_text(CANARY)
        sound = sound_files(door, root / "sound")
        for number in range(count):
            rng = random.Random(f"{door} {seed} {number}")
            one = sound[number % len(sound)]
            if not re.search(only, one.name):
                continue
            with limited(allowed):
                found = _one(door, one, number, rng, root)
            yield found


def own_peak() -> int:
    """Bytes of memory that this process has had at most. Not by getrusage: that begins with what started it has."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) << 10


def _one(door: Door, one: Sound, number: int, rng: random.Random, root: Path) -> Tried:
    folder, out = root / "in" / str(number), root / "out"
    source = changed(one, rng, folder)
    out.mkdir(exist_ok=True)
    earlier = (out / "x.mcap").read_bytes() if (out / "x.mcap").exists() else b""
    _events.clear()
    guard.last[:] = []
    began, harm = time.process_time(), []
    refused, told, made = "", [], b""
    try:
        refused, told, made = TRY[door](source, out, one)
    except Exception as problem:
        harm.append(f"crash: {type(problem).__name__}: {str(problem)[:300]}")
    spent = time.process_time() - began
    peak, child = guard.last or (own_peak(), 0.0)
    if max(spent, child) > SECONDS:
        harm.append("hang")
    if peak > PEAK:
        harm.append("memory")
    if any(not event.startswith("subprocess.Popen") for event in _events):
        harm.append(f"request: {_events[0]}")
    if any(not text.isprintable() for text in (*told, refused)) or len(refused) > 3000:
        harm.append("escape")
    if CANARY.encode() in made or CANARY in refused:
        harm.append("foreign bytes")
    if refused and earlier and (not (out / "x.mcap").exists() or (out / "x.mcap").read_bytes() != earlier):
        harm.append("lost result")
    if left := [name for name in os.listdir(out) if name.startswith(".")]:
        harm.append(f"left behind: {left[0]}")
    return Tried(door, f"{one.name} {number}", refused, tuple(harm), spent + child, peak)


def rows(found: list[Tried]) -> list[list[str]]:
    """A row for each door."""
    out = []
    for door in dict.fromkeys(one.door for one in found):
        mine = [one for one in found if one.door == door]
        harm = Counter(word.split(":")[0] for one in mine for word in one.harm)
        kinds = ("crash", "hang", "memory", "foreign bytes", "request", "lost result", "escape")
        contained = sum("its reader crashed" in one.refused or "--limits.memory" in one.refused for one in mine)
        row = [door, str(len(mine)), str(sum(bool(one.refused) for one in mine)), str(contained)]
        row += [f"{max(one.peak for one in mine) / 1e9:.2f}", f"{max(one.seconds for one in mine):.1f}"]
        out.append([*row, *(str(harm[kind]) for kind in kinds)])
    return out


HEAD = [
    "door", "inputs", "refused", "of these contained crashes and memory", "memory, GB", "longest, s", "crash", "hang",
    "over 2 GB", "foreign bytes", "request", "lost result", "escape",
]  # fmt: skip


def main(
    count: int = 2000, seed: int = 1, doors: tuple[Door, ...] = DOORS, only: str = "", quick: bool = False
) -> None:
    """Tries damaged and hostile files at doors other than MCAP.

    Args:
        count: how many at each door.
        seed: of what is random.
        doors: which ones.
        only: a regular expression for names of sound files.
        quick: with lower limits, which are reached sooner.
    """
    found, allowed = [], replace(ALLOWED, memory=200 << 20, seconds=2.0) if quick else ALLOWED
    for door in doors:
        for one in tried(door, count, seed, only, allowed):
            found.append(one)
            if one.harm:
                print(f"FAILED {one.door} {one.name}: {'; '.join(one.harm)}", flush=True)
    print(table(HEAD, rows(found)))
    raise SystemExit(int(any(one.harm for one in found)))


if __name__ == "__main__":
    tyro.cli(main)
