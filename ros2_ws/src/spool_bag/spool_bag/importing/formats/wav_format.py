"""WAV: readings as shares of the full scale, at a rate that the file states."""

from __future__ import annotations

import math
import warnings
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import ArrayTable, Channel, Group, check_size

#: Other chunks that are named, and B of one that are shown.
MOST_CHUNKS, LONGEST_CHUNK = 20, 200


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

    whole, warning = _whole(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)  # other chunks are named below
        try:
            rate, samples = wavfile.read(whole or path, mmap=whole is None)
        except ValueError:  # 24 bit cannot be mapped
            rate, samples = wavfile.read(path)
    columns = samples.reshape(samples.shape[0], -1)
    names = [str(at) for at in range(columns.shape[1])]
    channels = tuple(Channel(name, "FS") for name in names)
    arrays = {("", name): _Scaled(columns[:, at]) for at, name in enumerate(names)}
    others = _other_chunks(path)
    count = others.pop("fact", "")
    group = Group("", channels, float(rate), count=float(count) if count else math.nan)
    return ArrayTable(path, (group,), arrays, warnings=warning, settings=Settings(others))


def _other_chunks(path: Path) -> dict[str, str]:
    """Return what is beside the samples, such as a logger's scale in a list of texts, by chunk.

    ``fact``: number of samples by the chunk of that name.
    """
    found: dict[str, str] = {}
    size = path.stat().st_size
    with path.open("rb") as file:
        order: Literal["big", "little"] = "big" if file.read(4) == b"RIFX" else "little"
        at = 12
        while at + 8 <= size and len(found) < MOST_CHUNKS:
            file.seek(at)
            name, length = file.read(4), int.from_bytes(file.read(4), order)
            if name == b"fact":
                number = int.from_bytes(file.read(4), order)
                found |= {"fact": str(number)} if 0 < number < 0xFFFFFFFF else {}
            elif name not in (b"fmt ", b"data", b"ds64", b"JUNK", b"PAD "):
                text = "".join(
                    chr(one) if 32 <= one < 127 else " " for one in file.read(min(length, LONGEST_CHUNK))
                )
                found[f"chunk {printable(name.decode('ascii', 'replace').strip(), 4)}"] = " ".join(
                    text.split()
                )
            at += 8 + length + length % 2
    return found


def _whole(path: Path) -> tuple[BinaryIO | None, tuple[str, ...]]:
    """Return a file that is cut off as if it were whole, with the samples that are there, and a warning.

    A logger that was switched off leaves a header whose sizes are 0, or larger than the file.

    Raises:
        InputError: there is no header of samples in it, or no sample.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(1 << 16)
        order: Literal["big", "little"] = "big" if head[:4] == b"RIFX" else "little"
        at, frame = 12, 0
        while at + 8 <= len(head) and head[at : at + 4] != b"data":
            length = int.from_bytes(head[at + 4 : at + 8], order)
            if head[at : at + 4] == b"fmt ":
                frame = int.from_bytes(head[at + 20 : at + 22], order)
            at += 8 + length + length % 2
        if at + 8 > len(head) or frame == 0:
            if at + 8 > size:
                raise InputError(f"{path}: no samples in it: the file is cut off: copy it again")
            return None, ()  # a long header, which is left to the library
        begin = at + 8
        stated = int.from_bytes(head[at + 4 : begin], order)
        held = size - begin
        streamed = stated == 0 or (stated == 0xFFFFFFFF and head[:4] != b"RF64")
        if head[:4] == b"RF64" or (held >= stated and not streamed):
            return None, ()
        held -= held % frame
        if held == 0:
            raise InputError(f"{path}: no samples in it: the file is cut off: copy it again")
        check_size(path)
        file.seek(begin)
        content = bytearray(head[:begin] + file.read(held))
    content[4:8] = (len(content) - 8).to_bytes(4, order)
    content[begin - 4 : begin] = held.to_bytes(4, order)
    there = f"the {held // frame} samples that are there" + ("" if streamed else f", of {stated // frame},")
    return BytesIO(content), (f"the file is cut off or was never finished: {there} are read",)


FORMAT = Format("WAV", (".wav",), opened, begins=(b"RIFF", b"RF64", b"RIFX"))
