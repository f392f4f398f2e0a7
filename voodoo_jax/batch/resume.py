"""Logs that an earlier run has finished: results carry a key of everything that they depend on."""

import hashlib
import os
import zipfile
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader

from voodoo_jax.compile.executable import code_fingerprint
from voodoo_jax.config.options import Settings
from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.npz import tracks_arrays
from voodoo_jax.io.chunks import READ_ERRORS
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import format_body
from voodoo_jax.storage.urls import is_url, log_parts, opened, person_place

KEPT = ("body_json", "residual", "tracked", "seconds", "notes")  # of a tracks file
BLOCK = 1 << 16  # bytes of each sample of a log
# what a file that is missing, cut or of another kind raises
BROKEN = (OSError, ValueError, KeyError, EOFError, StopIteration, zipfile.BadZipFile, zlib.error, *READ_ERRORS)


def log_fingerprint(stream: Any, whole: bool = True) -> str:
    """A fingerprint of a log: its length and all its bytes, so that a repaired copy is another log and a copy elsewhere
    is the same. Not `whole`, for stores that are far: its bytes at the start, the end and two places between; the end
    holds the index and checksums. Raises OSError.
    """
    length = stream.seek(0, os.SEEK_END)
    digest = hashlib.sha256(str(length).encode())
    if whole:
        stream.seek(0)
        while block := stream.read(16 * BLOCK):
            digest.update(block)
        return digest.hexdigest()
    for part in range(4):
        stream.seek(max(0, (length - BLOCK) * part // 3))
        digest.update(stream.read(BLOCK))
    return digest.hexdigest()


def fingerprint_of(log: str, far: bool = False) -> str:
    """The fingerprint of a log, of all its files if it has several; `far`: of a copy of one in a store. Raises
    OSError."""
    found = []
    for part in log_parts(log):
        if not is_url(part) and not os.path.isfile(part):  # a pipe would be waited for
            raise FileNotFoundError(part)
        with opened(part) as stream:
            found.append(log_fingerprint(stream, whole=not (far or is_url(part))))
    return found[0] if len(found) == 1 else hashlib.sha256(" ".join(found).encode()).hexdigest()


def _body_bytes(body: Body) -> bytes:
    """All of a body: its file, which has the names, and its exact numbers."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(body)]
    return format_body(body).encode() + b"".join(repr((a.dtype.str, a.shape)).encode() + a.tobytes() for a in arrays)


def recipe_key(body: Body, settings: Settings, smooth_seconds: float, style: Style | None = None) -> str:
    """A key of everything that results depend on except the log: body, settings, smoothing, names, this package's
    code."""
    stages = {stage: values for stage, values in asdict(settings).items() if stage != "changes"}
    digest = hashlib.sha256(
        repr((stages, smooth_seconds, style or Style(), code_fingerprint())).encode() + _body_bytes(body)
    )
    for change in settings.changes:
        fields = {name: value for name, value in vars(change).items() if name != "add"}
        digest.update(repr(fields).encode() + _thing_bytes(change.add))
    return digest.hexdigest()


def _thing_bytes(thing: Body | str) -> bytes:
    """The object that a change adds: a body, a body file's content, or a name."""
    if isinstance(thing, Body):
        return _body_bytes(thing)
    return Path(thing).read_bytes() if os.path.isfile(thing) else thing.encode()


def run_key(recipe: str, fingerprint: str) -> str:
    """The key of one log's results."""
    return hashlib.sha256(f"{recipe} {fingerprint}".encode()).hexdigest()


def finished_arrays(log: str, npz: str, mcap: str, recipe: str) -> list[dict[str, np.ndarray]] | None:
    """What outcome_of_arrays needs of the tracks of each person in a log, if all result files are whole and carry this
    run's key; else None. `npz`, `mcap`: the main person's tracks, and what shows all."""
    try:
        with opened(npz) as stream:
            first = tracks_arrays(stream, npz)
        if "run_key" not in first:
            return None
        key = run_key(recipe, fingerprint_of(log))
        arrays = []
        for person in range(1, int(first.get("people", 1)) + 1):
            with opened(person_place(npz, person)) as stream:
                data = first if person == 1 else tracks_arrays(stream, npz)
            if str(data["run_key"]) != key or int(data.get("person", 1)) != person:
                return None
            arrays.append({name: data[name] for name in KEPT})
        with opened(mcap) as stream:
            metadata = [m.metadata for m in SeekingReader(stream).iter_metadata() if m.name == "voodoo_jax"]
            stream.seek(0)
            for _ in StreamReader(stream, validate_crcs=True).records:  # each chunk has a checksum
                pass
        return arrays if [m.get("run_key") for m in metadata] == [key] else None
    except BROKEN:
        return None
