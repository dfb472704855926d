"""Newest recorded spectra of a valve: what its waterfall shows when a page is opened."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections import deque
from pathlib import Path

from spool_bag.mcap_file import McapFile
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_core.block import Block
from spool_core.cdr import CdrError, decode_block
from spool_core.errors import InputError

from spool_view.view import MOST_SAMPLES, WINDOW, is_whole, spectrum_of

#: Recordings in a folder of recordings, and files in all, that are looked into at most, the newest first.
MOST_FOLDERS, MOST_FILES = 8, 8
#: B at the end of a file that are read: of one valve with 2000 samples/s over two minutes, of a hundred 20 s.
TAILS = (2_000_000, 32_000_000)
#: s after which no more is read.
LONGEST = 3.0
#: Share of the wanted time that is enough: the oldest message held is a little younger than that.
LEAST = 0.95
#: Samples of each channel that are held at most.
MOST_HELD = 60 * MOST_SAMPLES

Messages = deque[tuple[int, bytes]]


def recorded_spectra(bags: Path, valve: str, count: int, step: float) -> list[tuple[float, list[float]]]:
    """Return the newest spectra of the spool of ``valve``, with the times of reception (s since 1970).

    Reads the ends of the newest files only, for about :data:`LONGEST` s at most; damage is stepped over.

    Args:
        bags: a recording, also one under way, or a folder of recordings.
        valve: namespace.
        count: of spectra at most.
        step: s between two of them.

    Returns:
        Oldest first, each with lines as :func:`spectrum_of` gives them; empty without a record of the valve.

    Raises:
        InputError: there is no such folder.
        OSError: it cannot be read.
    """
    if not bags.is_dir():
        raise InputError(f"bags: {bags}: no such folder: name the recorder's output or the folder it lies in")
    wanted = round(1e9 * (count * step + WINDOW))
    end = time.monotonic() + LONGEST
    held: Messages = deque()
    for path in _newest(bags):
        before = held[0][0] if held else None
        for tail in TAILS:
            found = _last_of(path, valve, tail, wanted, before, end)
            if found and found[-1][0] - found[0][0] >= LEAST * wanted:
                break
        held.extendleft(reversed(found))
        if time.monotonic() > end or (held and held[-1][0] - held[0][0] >= LEAST * wanted):
            break
    return _spectra(held, count, round(1e9 * step))


def _newest(bags: Path) -> list[Path]:
    """Return the newest files of ``bags``, the newest first."""

    def age(path: Path) -> float:
        return -path.stat().st_mtime

    folders = [path for path in bags.iterdir() if path.is_dir()]
    near = [bags, *sorted(folders, key=age)[:MOST_FOLDERS]]
    return sorted((path for folder in near for path in folder.glob("*.mcap")), key=age)[:MOST_FILES]


def _last_of(path: Path, valve: str, tail: int, wanted: int, before: int | None, end: float) -> Messages:
    """Return the last blocks, over ``wanted`` ns, in ``tail`` B of a file, received ``before`` a time."""
    topic = f"/{valve}/acceleration"
    found: Messages = deque()
    size = 0
    try:
        file = McapFile(path)
        if file.times is not None and before is not None and file.times[0] >= before:
            return found
        for batch in file.batches(
            lambda one: (one.name, one.type) == (topic, ACCELERATION_BLOCK), lambda _: None, tail
        ):
            for message in batch.messages():
                if before is not None and message.log_time >= before:
                    return found
                found.append((message.log_time, message.data))
                size += len(message.data)
                while found[-1][0] - found[0][0] > wanted or size > 8 * MOST_HELD:
                    size -= len(found.popleft()[1])
            if time.monotonic() > end:
                break
    except (InputError, OSError):  # removed by the quota since, or no byte of it can be used
        return deque()
    return found


def _spectra(held: Messages, count: int, step: int) -> list[tuple[float, list[float]]]:
    times, blocks = list[int](), list[Block]()
    for received, data in held:
        try:
            blocks.append(decode_block(data))
        except CdrError:
            continue
        times.append(received)
    spectra: list[tuple[float, list[float]]] = []
    beyond = 0
    for number in range(count if times else 0):
        until = bisect_right(times, times[-1] - number * step)
        if until in (0, beyond):
            continue
        beyond = until
        # Twice the window: messages come late and in bursts.
        first = bisect_left(times, times[until - 1] - round(2e9 * WINDOW))
        spectrum = spectrum_of(blocks[first:until])
        if spectrum is not None and is_whole(spectrum):
            spectra.append((1e-9 * times[until - 1], spectrum["spool"]))
    return spectra[::-1]
