"""The exceptions and the warning of this package."""

from __future__ import annotations

from typing import Any, Optional


class EecvsError(Exception):
    """An error of reading, writing, encoding or decoding events.

    Attributes:
        file: Name of the file, or None where no file is involved.
        offset: Offset in bytes that the message names, or None.
    """

    file: Optional[str] = None
    offset: Optional[int] = None


class DamagedError(EecvsError, ValueError):
    """The input does not follow its format. All events before that place can be read: see ``damaged=`` of ``open``.

    Attributes:
        events: What was read before that place, where something was: an array, or columns.
    """

    events: Any = None


class UnsupportedError(EecvsError, ValueError):
    """A format, or a part of one, that is not read or written."""


class UndecidedError(EecvsError, ValueError):
    """The file leaves open what the caller has to state: a size, a unit, the meaning of the columns."""


class CannotHoldError(EecvsError, ValueError):
    """The output's format cannot hold an event or a sensor."""


class RefusedError(EecvsError, ValueError):
    """Something impossible or destructive was asked for; nothing was done.

    Attributes:
        frames: The last bytes, where ``Encoder.finish`` raised it.
    """

    frames: Optional[bytes] = None


class FileError(EecvsError, OSError):
    """The operating system reported an error; ``errno`` is its number."""


class MissingFileError(FileError, FileNotFoundError):
    """There is no such file."""


class LossWarning(UserWarning):
    """Events are missing or changed; the attribute ``losses`` of the object counts them."""


_KINDS = {
    "damaged": DamagedError,
    "unsupported": UnsupportedError,
    "undecided": UndecidedError,
    "cannot_hold": CannotHoldError,
    "refused": RefusedError,
    "io": FileError,
    "missing": MissingFileError,
}


def _make(
    kind: str, text: str, file: Optional[str], offset: Optional[int], errno: Optional[int]
) -> EecvsError:
    error = _KINDS.get(kind, EecvsError)(text)
    error.file = file
    error.offset = offset
    if errno is not None and isinstance(error, OSError):
        error.errno = errno
    return error
