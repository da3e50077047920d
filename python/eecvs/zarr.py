"""A codec of numcodecs, for arrays of events in Zarr: exact, in the order of the rows, chunk by chunk.

Zarr finds it by its name, ``eecvs``, wherever this package is installed. It needs numcodecs.
"""

from __future__ import annotations

from typing import Any, Union

import numpy as np
from numcodecs.abc import Codec  # type: ignore[import-untyped]
from numcodecs.compat import ensure_contiguous_ndarray, ndarray_copy  # type: ignore[import-untyped]
from numcodecs.registry import register_codec  # type: ignore[import-untyped]

from ._eecvs import _names, _pack, _unpack, _whole

__all__ = ["Events"]


class Events(Codec):  # type: ignore[misc]
    """Packs chunks of structured arrays of events.

    Rows that are no events come back as well, bit for bit, but do not become small. Every chunk has a checksum.

    Args:
        values: Size of a row, then offset and size of t, x, y and p, in bytes; ``Events.of(dtype)`` takes them from a
            data type.
        effort: 0, the quick coder, to 3: fewer bits for more time.
        bytes_max: Most bytes that a chunk may have when it is unpacked.

    Raises:
        ValueError: The values are no layout of events.
    """

    codec_id = "eecvs"

    def __init__(self, values: list[int], effort: int = 0, bytes_max: int = 1 << 30) -> None:
        self.values = [_whole(value, "values", 0, 2**32 - 1) for value in values]
        self.effort = _whole(effort, "effort", 0, 3)
        self.bytes_max = _whole(bytes_max, "bytes_max", 0, 2**63 - 1)
        _pack(b"", self._layout())

    @classmethod
    def of(cls, dtype: Any, effort: int = 0, bytes_max: int = 1 << 30, *, gaps: bool = False) -> Events:
        """Returns the codec of arrays of a data type, such as ``eecvs.DTYPES["eecvs"]``.

        Zarr leaves out the gaps between fields, and so does this, unless ``gaps`` says that rows have them.

        Raises:
            ValueError: The data type has no field of an event, or one that is no whole number of little-endian bytes.
        """
        dtype = np.dtype(dtype)
        if dtype.names and not gaps:
            dtype = np.dtype([(name, dtype[name]) for name in dtype.names])
        fields = dtype.fields or {}
        values = [dtype.itemsize]
        for names in _names():
            found = next((fields[name] for name in names if name in fields), None)
            if found is None or found[0].kind not in "iub" or found[0].str[0] == ">":
                raise ValueError(f"{dtype} has no field {' or '.join(names)} of little-endian whole numbers")
            values += [found[1], found[0].itemsize]
        return cls(values, effort, bytes_max)

    def _layout(self) -> list[int]:
        return [*self.values, self.effort]

    def encode(self, buf: Any) -> bytes:
        """Packs a chunk.

        Raises:
            ValueError: The rows are not of this codec's layout.
        """
        if isinstance(buf, np.ndarray) and buf.dtype.names and Events.of(buf.dtype, gaps=True).values != self.values:
            raise ValueError(f"rows of {buf.dtype} are not of this codec's layout {self.values}")
        # numcodecs has no view of structured arrays as bytes.
        rows = np.ascontiguousarray(buf) if isinstance(buf, np.ndarray) else ensure_contiguous_ndarray(buf)
        return _pack(rows.reshape(-1).view(np.uint8).data, self._layout())

    def decode(self, buf: Any, out: Union[Any, None] = None) -> Any:
        """Unpacks a chunk.

        Raises:
            DamagedError: The chunk was changed.
            ValueError: It has more than ``bytes_max`` bytes.
        """
        return ndarray_copy(_unpack(ensure_contiguous_ndarray(buf), self._layout(), self.bytes_max), out)


register_codec(Events)
