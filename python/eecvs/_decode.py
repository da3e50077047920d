"""Frames to events in one call."""

from __future__ import annotations

from typing import Any, Union

import numpy as np
import numpy.typing as npt

from ._eecvs import Decoder
from ._types import DTYPES


def decode(frames: Any, *, dtype: Union[str, None] = None, **options: Any) -> npt.NDArray[np.void]:
    """Decodes frames to events: the inverse of ``encode``.

    Args:
        frames: What ``encode`` returned, or the content of an ``.eecvs`` file: bytes, or any buffer.
        dtype: Layout of the array, as for ``open``.
        **options: Those of ``Decoder``.

    Returns:
        A structured array, (N,), of the windows' events one after the other.

    Raises:
        DamagedError: The bytes are no frames. What is damaged among whole frames is a LossWarning.
    """
    decoder = Decoder(dtype=dtype, **options)  # type: ignore[arg-type]
    windows = decoder.push(frames) + decoder.finish()
    layout = DTYPES[dtype or "eecvs"]
    # Without the data type, NumPy would leave out the gaps between the fields.
    return np.concatenate([np.empty(0, layout), *(window.events for window in windows)], dtype=layout)
