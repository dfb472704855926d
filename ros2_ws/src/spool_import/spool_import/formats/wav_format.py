"""WAV: readings as shares of the full scale, at a rate that the file states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spool_import.tables.table import ArrayTable, Channel, Group

from .format import Format


class _Scaled:
    """Channel of a WAV file, scaled to full scale only when it is read."""

    def __init__(self, samples: Any) -> None:
        self._samples = samples

    def __array__(self, *_: object, **__: object) -> Any:
        row = np.asarray(self._samples)
        if row.dtype == np.uint8:
            return (row.astype(np.float64) - 128.0) / 128.0
        if row.dtype.kind == "i":
            return row / float(-np.iinfo(row.dtype).min)
        return row.astype(np.float64)


def opened(path: Path) -> ArrayTable:
    """Return the channels of a WAV file, by number from 0."""
    from scipy.io import wavfile  # noqa: PLC0415 - 30 MB that others do not need

    try:
        rate, samples = wavfile.read(path, mmap=True)
    except ValueError:  # 24 bit cannot be mapped
        rate, samples = wavfile.read(path)
    columns = samples.reshape(samples.shape[0], -1)
    names = [str(at) for at in range(columns.shape[1])]
    channels = tuple(Channel(name, "FS") for name in names)
    arrays = {("", name): _Scaled(columns[:, at]) for at, name in enumerate(names)}
    return ArrayTable(path, (Group("", channels, float(rate)),), arrays)


FORMAT = Format("WAV", (".wav",), opened, begins=(b"RIFF", b"RF64", b"RIFX"))
