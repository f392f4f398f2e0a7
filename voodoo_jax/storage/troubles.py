"""Error messages for files that cannot be written or read: which file, why, and what to do."""

import errno
import os
import stat
from typing import BinaryIO

FilePath = str | os.PathLike[str]
ROOM = "make room, or name another folder for results; the same command then continues"
RIGHTS = "you have no permission to write there", "name another folder for results"
READ_ONLY = "the disk is read-only", "name another folder for results"
# error of the system: why a file cannot be written, and what to do
REASONS = {
    errno.ENOSPC: ("the disk is full", ROOM),
    errno.EDQUOT: ("your disk quota is used up", ROOM),
    errno.EFBIG: ("it would be larger than files may be (ulimit -f)", "allow larger ones"),
    errno.EROFS: READ_ONLY,
    errno.EACCES: RIGHTS,
    errno.EPERM: RIGHTS,
    errno.ENOENT: ("its folder does not exist", "create it, and run the same command again"),
    errno.ENOTDIR: ("a part of its path is a file and no folder", "name another folder for results"),
    errno.EEXIST: ("a file or a broken link of this name is there", "name a folder"),
    errno.EISDIR: ("a folder of this name is there", "rename that folder, or name another one for results"),
    errno.ENAMETOOLONG: ("its name is too long for the disk", "shorten the name"),
    errno.ELOOP: ("links in its path form a loop", "name another folder for results"),
    errno.EMFILE: ("too many files are open (ulimit -n)", "allow more, or use fewer --workers"),
    errno.ENFILE: ("too many files are open", "use fewer --workers"),
    errno.EIO: ("the disk reports an error", "check it, and name a folder on another one"),
}
# errors of writing that come without the name of the file
WHILE_WRITING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
SMALL = 64 << 20  # bytes: no file that people write by hand or a drawing program makes for a body is larger


class NotWritten(OSError):
    """A file or folder that cannot be written: a sentence with its name, the reason and what to do."""


class NotReadable(OSError):
    """Something that is not a file, or is too large for its kind."""


def not_written(problem: OSError, place: FilePath) -> NotWritten:
    """The exception to raise if `place` cannot be written."""
    if isinstance(problem, NotWritten):
        return problem
    why, advice = REASONS.get(problem.errno or 0, (problem.strerror or str(problem), "name another folder for results"))
    found = NotWritten(f"'{os.fspath(place)}' cannot be written: {why}; {advice}")
    found.errno = problem.errno
    return found


def check_text(place: FilePath, what: str) -> None:
    """Raises ValueError for a path with bytes that are not UTF-8: formats and libraries cannot store it."""
    if not (text := os.fspath(place)).isascii():
        try:
            text.encode("utf-8")
        except UnicodeEncodeError as problem:
            shown = text.encode("utf-8", "backslashreplace").decode()
            raise ValueError(
                f"{what} '{shown}': a name in it is not UTF-8; rename it, or name another one"
            ) from problem


def opened_file(path: FilePath, inside: FilePath | None = None) -> BinaryIO:
    """Opens a file for reading. Raises NotReadable for pipes and devices, which may block forever, and for files
    outside of the folder `inside`, also by a link; OSError."""
    place = os.path.realpath(path) if inside is not None else os.fspath(path)
    if inside is not None and os.path.commonpath([place, folder := os.path.realpath(inside)]) != folder:
        raise _unfit(f"it lies outside of '{os.fspath(inside)}'")
    # a pipe that nobody writes into must not be waited for
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    handle = os.open(place, flags | (getattr(os, "O_NOFOLLOW", 0) if inside is not None else 0))
    stream = os.fdopen(handle, "rb") if stat.S_ISREG((status := os.fstat(handle)).st_mode) else None
    if stream is None:
        os.close(handle)
        raise _unfit(f"it is a {'folder' if stat.S_ISDIR(status.st_mode) else 'pipe or a device'}: give a file")
    return stream


def small_file(path: FilePath, inside: FilePath | None = None, most: int = SMALL) -> bytes:
    """Content of a file of at most this many bytes, for files beside logs: settings, a body, a calibration. Raises
    NotReadable for others, and as opened_file; OSError."""
    with opened_file(path, inside) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > most:
            raise _unfit(f"it has {size} bytes, more than the {most} allowed for such files")
        return stream.read(most + 1)


def small_text(path: FilePath, errors: str = "strict", inside: FilePath | None = None) -> str:
    """The same as UTF-8 text with universal line ends. Also raises UnicodeDecodeError."""
    return small_file(path, inside).decode("utf-8-sig", errors).replace("\r\n", "\n").replace("\r", "\n")


def check_file(path: FilePath, inside: FilePath | None = None) -> None:
    """Raises what opened_file raises, for files that a library opens; folders pass if no `inside` is given."""
    if inside is not None or os.path.exists(path) and not os.path.isdir(path):
        opened_file(path, inside).close()


def _unfit(why: str) -> NotReadable:
    found = NotReadable(why)
    found.strerror = why
    return found
