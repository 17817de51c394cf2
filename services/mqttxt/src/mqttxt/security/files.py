"""Files of an identity: read with errors that name them, written so that no reader sees half of one."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..errors import ConfigurationError

MOST_BYTES = 4_000_000
_HAS_MODES = hasattr(os, "geteuid")
"""Whether files have owners and modes, and folders can be synced. Windows has access lists, which a file inherits."""


def read(path: Path, *, private: bool = False) -> bytes:
    """A file's bytes. Raises ConfigurationError; for a private file also if its group or others have access."""
    try:
        with path.open("rb") as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            if private and _HAS_MODES and mode & 0o077:
                raise ConfigurationError(
                    f"{path}: mode {mode:04o}, so others can use the key; expected 0600: chmod 600 {path}"
                )
            found = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}; expected a file that can be read") from error
    if len(found) > MOST_BYTES:
        raise ConfigurationError(f"{path}: longer than {MOST_BYTES} bytes; expected a PEM file")
    return found


def is_folder(path: Path, name: str = "") -> bool:
    """Whether a path leads to a folder. Raises ConfigurationError, which names the path or `name`, if none can tell."""
    mode = _mode(path, name)
    return mode is not None and stat.S_ISDIR(mode)


def is_there(path: Path) -> bool:
    """Whether a path leads to anything. Raises ConfigurationError if none can tell, as of a name that is too long."""
    return _mode(path) is not None


def _mode(path: Path, name: str = "") -> int | None:
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        what = name or str(path)
        raise ConfigurationError(f"{what}: {error.strerror or error}; expected a path that can be read") from error


def replaceable(path: Path) -> Path:
    """The path of the file that `path` leads to, for replacing it, behind symbolic links: a link stays a link.

    Raises OSError if there is something else than a regular file, as a device, which replacing would remove.
    """
    target = Path(os.path.realpath(path)) if os.path.islink(path) else path
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return target
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, "is a folder")
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "not a regular file")
    return target


def named_by_user(path: Path) -> Path:
    """The file to write for a path that a user names; raises ConfigurationError if no file can be written there."""
    try:
        target = replaceable(path)
        if not target.parent.is_dir():
            raise OSError(errno.ENOENT, "no such folder")
    except OSError as error:
        why = error.strerror or error
        raise ConfigurationError(f"{path}: {why}; expected a file in a folder that exists") from error
    return target


@contextlib.contextmanager
def changing(path: Path) -> Iterator[None]:
    """Turn an OSError in the block into a ConfigurationError that names `path`."""
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}; expected to be able to write it") from error


def write(path: Path, content: bytes, mode: int = 0o644, like: Path | None = None) -> None:
    """Replace a file durably and in one step; raises ConfigurationError.

    If root writes it, it gets the owner of `like`.
    """
    with changing(path):
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
        try:
            with os.fdopen(handle, "wb") as file:
                if _HAS_MODES:
                    _give(file.fileno(), mode, like)
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        if _HAS_MODES:
            _sync_folder(path.parent)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes out of the same block for a folder, where system and file system have locks.

    Raises ConfigurationError if there is no such folder.
    """
    if not _HAS_MODES:
        yield
        return
    import fcntl  # Windows has none

    with changing(folder):
        handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _give(file: int, mode: int, like: Path | None) -> None:
    os.fchmod(file, mode)
    if like is not None and os.geteuid() == 0:
        owner = like.stat()
        os.fchown(file, owner.st_uid, owner.st_gid)


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
