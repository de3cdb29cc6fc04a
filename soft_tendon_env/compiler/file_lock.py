"""Advisory locks between processes: a file that one process holds, until it lets go or ends, however it ends.

The operating system keeps the lock for the process, not for an open file: a forked child holds nothing of its parent's, and whoever holds
a lock may lock it again. It also lets go when the process closes *any* descriptor of the file, so the holder does not open it to read.
"""

import os
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

ATTEMPTS = 20
LOCKED_BYTE = 1 << 20  # beyond the text, which others read; Windows keeps them from what is locked


def try_lock(path: Path, text: str) -> int | None:
    """Create and lock a file, with a text for those who find it locked; None: another process holds it.

    The descriptor goes to `unlock`. Raises OSError where files cannot be created or locked.
    """
    for _ in range(ATTEMPTS):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        kept = locked = False
        try:
            locked = _lock(descriptor)
            if locked and _is_at(path, descriptor):  # else whoever held it has removed it meanwhile: nobody will find this one
                _write(descriptor, text)
                kept = True
                return descriptor
        finally:
            if not kept:
                os.close(descriptor)
        if not locked:
            return None
    raise OSError(f"{path} is another file each time that it is looked at")


def unlock(path: Path, descriptor: int) -> None:
    """Removes the file and releases its lock."""
    try:
        path.unlink()
    except OSError:
        pass  # Windows keeps open files; somebody else may have removed the folder
    os.close(descriptor)


def _lock(descriptor: int) -> bool:
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _is_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _write(descriptor: int, text: str) -> None:
    try:
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, text.encode())
    except OSError:
        pass  # on a full disk the lock holds all the same
