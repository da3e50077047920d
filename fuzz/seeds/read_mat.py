#!/usr/bin/env python3
"""Writes the seeds in fuzz/seeds/read_mat/, which crates/event-files/tests/formats/mat.rs reads as well.

    pip install scipy
    python3 fuzz/seeds/read_mat.py
"""

from pathlib import Path

import numpy as np
from scipy.io import savemat

FOLDER = Path(__file__).parent / "read_mat"
START_US = 1_000_000
I = np.arange(300)
T, X, Y, ON = START_US + I * 17, I * 7 % 64, I * 3 % 48, I % 3 == 0


def column(values, of="f8"):
    return np.asarray(values).astype(of)[:, None]


def save(name, variables, packed=False):
    FOLDER.mkdir(exist_ok=True)
    savemat(FOLDER / f"{name}.mat", variables, do_compression=packed)


# As Prophesee's load_atis_data: doubles, p = 1 or -1; the second structure has none of the events' fields.
td = {"x": column(X), "y": column(Y), "p": column(np.where(ON, 1, -1)), "ts": column(T)}
save("structure", {"td_data": td, "info": {"camera": "ATIS", "x": 1.0}})
save("structure_packed", {"td_data": td, "width": 64, "height": 48}, packed=True)
# As N-MNIST's Read_Ndataset: everything counts from 1.
save("from_one", {"TD": {"x": column(X + 1), "y": column(Y + 1), "p": column(ON + 1), "ts": column(T)}})
# Rows of integers.
save("variables", {"t": T.astype("i8"), "x": X.astype("u2"), "y": Y.astype("u1"), "p": ON, "note": "rows"})
save("variables_packed", {"ts": T / 1e6, "x": X.astype("i2"), "y": Y.astype("f4"), "pol": ON.astype("i1")}, packed=True)
save("matrix", {"events": np.stack([T, X, Y, ON], axis=1).astype("f8"), "labels": np.zeros((3, 4))})
save("matrix_packed", {"a": np.stack([X, Y, ON, T], axis=1).astype("u4"), "cells": np.array([[1, "b"]], object)}, packed=True)
