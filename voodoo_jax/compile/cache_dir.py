"""Compiled programs kept for later processes: jax's persistent compilation cache, made safe for many at once.

jax writes an entry in place, so that a process that is killed meanwhile leaves half of one for good. Here each process
writes into a folder of its own and links whole entries to the shared one. Executables that this package keeps itself
(`keep`) are read where they are: of thousands a process needs a few.

An entry is a program that is run, so whoever can write one can run code as this user. A folder is used only if it
belongs to this user and no other user can write in it; files are opened without following links, and read only if they
belong to this user, too.
"""

import atexit
import hashlib
import os
import platform
import shutil
import socket
import stat
import tempfile
import threading
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

import platformdirs
import zstandard

LOCK, OURS = "lock-", "program-"  # how names of locks, and of entries of `keep`, begin
ZSTD = b"\x28\xb5\x2f\xfd"  # how what is packed so begins (RFC 8878); jax packs entries so or by zlib
PATIENCE = 300.0  # seconds that a process waits for what another one compiles
DIGEST = 32  # bytes of checksum before an entry of `keep`
OLD_SECONDS = 2 * 86_400  # a process's folder of another machine that is older was left by a killed one
UNUSED_SECONDS = 30 * 86_400  # an entry that nobody has asked for so long is of code that has changed since
OTHERS = stat.S_IWGRP | stat.S_IWOTH  # mode bits: somebody else can write
# absent on Windows; a pipe in place of a file must not keep a process waiting
OPENED = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
_own: dict[str, tuple[Path, Path]] = {}  # folder as asked for -> the shared one, this process's own
_turn, _aside = threading.Lock(), 0  # how many threads compile without jax's cache
_first = threading.Lock()  # two threads that begin to track
_warned: set[str] = set()  # what has been said


class CacheError(ValueError):
    """The folder that the user named for compiled programs is not safe."""


def cache_folder(asked: str) -> str:
    """The folder for compiled programs: the path `asked`, or none (empty) for "off". If `asked` is empty: that of the
    environment variable VOODOO_JAX_COMPILE_CACHE, or one in the user's cache."""
    asked = asked or os.environ.get("VOODOO_JAX_COMPILE_CACHE", "")
    if asked:
        return "" if asked == "off" else str(Path(asked).expanduser().absolute())
    try:
        return str(platformdirs.user_cache_path("voodoo_jax", appauthor=False))
    except RuntimeError:  # no HOME, and a user whom the system does not know, as in containers
        return str(Path(tempfile.gettempdir()) / f"voodoo_jax-{os.geteuid() if os.name == 'posix' else 'cache'}")


def refused(folder: str) -> str:
    """Why a folder must not be used, in a sentence, or nothing; makes it, for this user alone, where it is missing.
    Raises OSError where that does not work."""
    Path(folder).mkdir(mode=0o700, parents=True, exist_ok=True)
    shared = _shared(folder)
    shared.mkdir(mode=0o700, exist_ok=True)
    if os.name != "posix":
        return ""
    other = "name a folder of your own (--compile-cache or VOODOO_JAX_COMPILE_CACHE; off for none)"
    for place in (Path(folder), shared):
        # a link is somebody's, too
        if {os.lstat(place).st_uid, os.stat(place).st_uid} != {os.geteuid()}:
            return f"no compile cache in {place}: it belongs to another user, who could run code as you; {other}"
        if os.stat(place).st_mode & OTHERS:
            return (
                f"no compile cache in {place}: other users can write in it, so they could run code as you; remove "
                f"their permission (chmod go-w '{place}') and empty it if somebody may have written there, or {other}"
            )
    # not the owners and groups of folders above: who exchanges a folder still cannot make files of this user
    for place in Path(folder).resolve().parents:
        mode = os.stat(place).st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return f"no compile cache in {folder}: anybody can replace the contents of {place}; {other}"
    return ""


def _warn(problem: str) -> None:
    if problem not in _warned:
        _warned.add(problem)
        warnings.warn(f"{problem}. Continuing without: compiling takes half a minute.", RuntimeWarning, stacklevel=4)


def safe_folder(asked: str, say: Callable[[str], None] = _warn) -> str:
    """As cache_folder; if that folder must not be used: CacheError if the user named it, otherwise none, and `say`
    gives the reason."""
    folder = cache_folder(asked)
    try:
        problem = refused(folder) if folder else ""
    except OSError:  # use_compile_cache tells
        return folder
    if problem and asked:
        raise CacheError(problem)
    if problem:
        say(problem)
    return "" if problem else folder


@contextmanager
def users_cache() -> Iterator[None]:
    """For functions that are called from Python: compiles with the user's cache as the command does. It stays in use
    afterwards; what is wrong with it is said once, as a warning."""
    with _first:
        problem = "" if _own else use_compile_cache(cache_folder(""))
    if problem:
        _warn(problem)
    try:
        yield
    finally:
        keep_compiled()


def use_compile_cache(folder: str) -> str:
    """Lets jax take compiled programs from a folder (empty: does nothing) and keep them for `keep_compiled`.

    A cache that jax has been given already (JAX_COMPILATION_CACHE_DIR) stays as it is. Returns why it does not work,
    or nothing: slower is better than not at all.
    """
    if not folder:
        return ""
    if folder in _own:
        link_all(*_own[folder])
        return ""
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    if jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue]
        return ""
    try:
        if problem := refused(folder):
            return problem
        shared = _shared(folder)
        sweep(shared)
        own = Path(tempfile.mkdtemp(prefix=f"run-{socket.gethostname()}-{os.getpid()}-", dir=shared))
        link_all(shared, own)
    except OSError as problem:
        return f"no compile cache in {folder}: {problem.strerror}"
    _own[folder] = shared, own
    # whoever has compiled before without a cache would never look for one
    compilation_cache.reset_cache()
    jax.config.update("jax_compilation_cache_dir", str(own))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")
    # a full disk, or a folder that somebody has cleared: compiled again next time
    warnings.filterwarnings("ignore", "Error writing persistent compilation cache entry")
    atexit.register(leave_compile_cache)
    return ""


def leave_compile_cache() -> None:
    """Hands on what was compiled, and removes this process's own folders."""
    for folder in list(_own):
        shared, own = _own.pop(folder)
        link_all(own, shared)
        shutil.rmtree(own, ignore_errors=True)


def _forget_parents() -> None:
    """In a copy of a process: the folders are the original's."""
    if _own:
        import jax

        _own.clear()
        jax.config.update("jax_compilation_cache_dir", None)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_parents)


def keep_compiled() -> None:
    """Hands what was compiled since the last call to other processes."""
    for shared, own in list(_own.values()):
        link_all(own, shared)


@contextmanager
def jax_cache_aside() -> Iterator[None]:
    """Compiles without jax's cache what `keep` keeps: a program that jax has loaded from there cannot be kept whole."""
    global _aside
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    def give(folder: str | None) -> None:
        compilation_cache.reset_cache()
        jax.config.update("jax_compilation_cache_dir", folder)

    with _turn:
        _aside += 1
        if _own and _aside == 1:
            give(None)
    try:
        yield
    finally:
        with _turn:
            _aside -= 1
            if _own and not _aside:
                give(str(next(iter(_own.values()))[1]))


def kept(name: str) -> bytes | None:
    """What some process has kept under a name (see executable.py); None if nothing, or not whole."""
    for shared, _ in list(_own.values()):
        with suppress(OSError):
            data = _read(entry := _entry(shared, name))
            with suppress(OSError):  # a folder that can only be read
                os.utime(entry)  # see sweep
            if hashlib.sha256(data[DIGEST:]).digest() == data[:DIGEST]:
                return zlib.decompress(data[DIGEST:])
            spoiled(name)
    return None


def keep(name: str, data: bytes) -> None:
    """Keeps something for other processes, at once: what takes long to make, two should not make."""
    packed = zlib.compress(data, 1)
    for shared, own in list(_own.values()):
        with suppress(OSError):  # as in link_all
            _write(partial := own / f".{name}.tmp", hashlib.sha256(packed).digest() + packed)
            os.replace(partial, _entry(shared, name))


def spoiled(name: str) -> None:
    """Takes away what was kept under a name."""
    for shared, _ in list(_own.values()):
        with suppress(OSError):
            _entry(shared, name).unlink()


@contextmanager
def alone(name: str) -> Iterator[None]:
    """Waits until no other process is busy with this name, or for so long that it is not worth it."""
    from filelock import FileLock, Timeout  # takes a while, and few processes compile

    with ExitStack() as stack:
        for shared, _ in list(_own.values()):
            with suppress(OSError, Timeout):
                lock = shared / f"{LOCK}{name}"
                stack.enter_context(FileLock(lock, PATIENCE, mode=0o600))
                stack.callback(lock.unlink, missing_ok=True)
        yield


def _entry(folder: Path, name: str) -> Path:
    return folder / f"{OURS}{name}-cache"


def link_all(source: Path, target: Path) -> None:
    """Gives `target` all entries of `source` that it does not have, each whole or not at all."""
    with suppress(OSError):  # a full disk, or a folder that somebody has cleared: compiled again next time
        there = set(os.listdir(target))
        for name in os.listdir(source):
            if not name.endswith("-cache") or name in there or name.startswith(OURS):  # see keep
                continue
            if source.name.startswith("run-") and not _complete(source / name):
                (source / name).unlink(missing_ok=True)
                continue
            _link(source / name, target / name)


def _complete(entry: Path) -> bool:
    """Whether an entry that jax has written here is whole: a full disk leaves the first part of one, which jax would
    neither use nor write again. Raises OSError."""
    data = entry.read_bytes()
    unpacking = zstandard.ZstdDecompressor().decompressobj() if data[:4] == ZSTD else zlib.decompressobj()
    try:
        unpacking.decompress(data)
        return unpacking.eof
    except (zlib.error, zstandard.ZstdError):
        return False


def _link(source: Path, target: Path) -> None:
    if not _trusted(os.lstat(source)):
        if source.parent.name.startswith("run-"):  # jax wrote it here, where nobody else can, by a generous umask
            os.chmod(source, 0o600)
        else:
            return
    try:
        os.link(source, target)
    except FileExistsError:
        pass
    except OSError:  # a file system without links
        partial = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        _write(partial, _read(source))
        os.replace(partial, target)


def _trusted(status: os.stat_result) -> bool:
    """Whether a file is an ordinary one of this user that others cannot write."""
    if os.name != "posix":
        return True
    return stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & OTHERS


def _read(path: Path) -> bytes:
    """What is in a file that can be trusted. Raises OSError for others."""
    with os.fdopen(os.open(path, OPENED | os.O_RDONLY | getattr(os, "O_BINARY", 0)), "rb") as stream:
        if not _trusted(os.fstat(stream.fileno())):
            raise PermissionError(f"{path} is not private to this user")
        return stream.read()


def _write(path: Path, data: bytes) -> None:
    """Creates a file that only this user can read. Raises OSError."""
    path.unlink(missing_ok=True)
    made = os.open(path, OPENED | os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600)
    with os.fdopen(made, "wb") as stream:
        stream.write(data)


def _shared(folder: str) -> Path:
    """Where in a cache folder the programs for this machine are."""
    return Path(folder) / _machine()


def _machine() -> str:
    """A name for what compiled programs run on: this version of jax on this kind of processor."""
    kind = platform.machine() + platform.processor()
    with suppress(OSError):  # Linux: programs use whatever instructions the processor has
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        kind += "".join(sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))}))
    return f"jax-{version('jax')}-{version('jaxlib')}-{hashlib.sha256(kind.encode()).hexdigest()[:12]}"


def process_runs(pid: int) -> bool:
    """Whether a process of this number runs on this machine; where that cannot be asked, True."""
    if os.name != "posix":  # elsewhere the question ends the process
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def sweep(shared: Path) -> None:
    """Removes what killed processes have left, and what has not been used for long."""
    with os.scandir(shared) as entries:  # once: there may be thousands
        for entry in entries:
            with suppress(OSError, ValueError):
                age = time.time() - entry.stat(follow_symlinks=False).st_mtime
                if entry.name.startswith("run-"):
                    host, pid = entry.name.removeprefix("run-").rsplit("-", 2)[:2]
                    if age > OLD_SECONDS or (host == socket.gethostname() and not process_runs(int(pid))):
                        shutil.rmtree(entry, ignore_errors=True)
                elif age > (OLD_SECONDS if entry.name.startswith(LOCK) else UNUSED_SECONDS):
                    os.unlink(entry)
