"""The file under a bag: unbuffered, synchronised on demand, with room kept to end it on
a full disk.
"""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from pathlib import Path
from typing import IO

# bytes kept free for the last chunk, the index and metadata.yaml
RESERVE = 4 * 1024 * 1024
_FULL = (errno.ENOSPC, errno.EDQUOT)


class BagStream:
    """The file that mcap's Writer writes its whole records to.

    On a full disk a kept reserve is given up: the record under way is still written,
    and so is the end of the bag. Where the reserve does not help (a limit on the file's
    size) the write raises.

    Args:
        path: of the new file; the folder exists.
        reserve: bytes to keep free for the end.

    Attributes:
        complete: where the last whole write ended.
        synced: where it ended when the disk confirmed last.
        writes: how many writes there were.
        full: the error that gave the reserve up, or None.

    Raises:
        OSError: the file exists or cannot be made, or the disk has no room for the
            reserve.
    """

    def __init__(self, path: Path, reserve: int = RESERVE) -> None:
        self.complete = 0
        self.synced = 0
        self.writes = 0
        self.full: OSError | None = None
        self._reserve: IO[bytes] | None = None
        self._reserved = 0
        self._file = open(path, "xb", buffering=0)
        self.tell, self.flush = self._file.tell, self._file.flush
        try:
            self._keep_free(path.parent, reserve)
            sync_folder(path.parent)
        except OSError:
            self.close()
            path.unlink()
            raise

    @property
    def closed(self) -> bool:
        """Whether the file was closed."""
        return self._file.closed

    def write(self, data: bytes) -> int:
        """Write all of the data."""
        view = memoryview(data)
        done = 0
        while done < len(view):
            try:
                done += self._file.write(view[done:]) or 0
            except OSError as error:
                if error.errno not in _FULL or self._reserve is None:
                    raise
                self.full = error
                self._release()
        self.complete += done
        self.writes += 1
        return done

    def reserve(self, size: int) -> None:
        """Keep at least ``size`` bytes free; a disk that has no more room counts as
        full.
        """
        if self._reserve is None or size <= self._reserved:
            return
        try:
            os.posix_fallocate(self._reserve.fileno(), 0, size)
            self._reserved = size
        except OSError as error:
            if error.errno in _FULL:
                self.full = error

    def cut(self) -> None:
        """Drop what came after the last whole write."""
        self._file.truncate(self.complete)

    def sync(self) -> None:
        """Wait until the disk has what was written.

        Raises:
            OSError: it has not, or somebody deleted the file.
        """
        if os.fstat(self._file.fileno()).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "the file was deleted")
        end = self.complete
        os.fsync(self._file.fileno())
        self.synced = end

    def close(self) -> None:
        """Close the file and give the reserve back."""
        self._release()
        self._file.close()

    def _keep_free(self, folder: Path, size: int) -> None:
        try:
            self._reserve = tempfile.TemporaryFile(dir=folder, buffering=0)
            os.posix_fallocate(self._reserve.fileno(), 0, size)
            self._reserved = size
        except OSError as error:
            self._release()
            if error.errno in _FULL:
                raise OSError(
                    error.errno,
                    f"{error.strerror} ({size >> 20} MiB are kept free to end the bag)",
                ) from error

    def _release(self) -> None:
        if self._reserve is not None:
            self._reserve.close()
            self._reserve = None


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the folder's entries; some file systems cannot be asked
    to.
    """
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
