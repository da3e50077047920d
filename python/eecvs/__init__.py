"""Event-camera recordings of every format, an exact codec for them, and arrays for networks.

``open`` reads a recording, ``write`` writes one, ``encode`` and ``decode`` are the codec, and ``voxel``, ``counts``,
``time_surface`` and ``tore`` make arrays. ``emulate`` makes scenes, ``compare`` measures distortion, ``picture`` draws
events. Times are whole microseconds, ranges of them half-open.
"""

import sys

from ._decode import decode
from ._eecvs import (
    Columns,
    Decoder,
    Encoder,
    Picture,
    Recording,
    Slices,
    Times,
    Window,
    _scenes,
    compare,
    counts,
    emulate,
    encode,
    open,
    picture,
    time_surface,
    tore,
    voxel,
    write,
)
from ._errors import (
    CannotHoldError,
    DamagedError,
    EecvsError,
    FileError,
    LossWarning,
    MissingFileError,
    RefusedError,
    UndecidedError,
    UnsupportedError,
)
from ._types import CAUSES, DTYPES, Comparison, EncodeOptions, Info, Sensor, Truth, Written

if sys.platform == "linux":
    from ._eecvs import Capture, capture

#: The scenes of ``emulate``: their names, and what each is.
SCENES: dict[str, str] = dict(_scenes())

__all__ = [
    "CAUSES",
    "DTYPES",
    "SCENES",
    "CannotHoldError",
    "Columns",
    "Comparison",
    "DamagedError",
    "Decoder",
    "EecvsError",
    "EncodeOptions",
    "Encoder",
    "FileError",
    "Info",
    "LossWarning",
    "MissingFileError",
    "Picture",
    "Recording",
    "RefusedError",
    "Sensor",
    "Slices",
    "Times",
    "Truth",
    "UndecidedError",
    "UnsupportedError",
    "Window",
    "Written",
    "compare",
    "counts",
    "decode",
    "emulate",
    "encode",
    "open",
    "picture",
    "time_surface",
    "tore",
    "voxel",
    "write",
]
if sys.platform == "linux":
    __all__ += ["Capture", "capture"]
