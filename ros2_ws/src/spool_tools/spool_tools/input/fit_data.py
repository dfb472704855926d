"""Fit data: records with motion in them, in fitted and held-out parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_estimator.plausibility import check_rate, check_records
from spool_sim.valve.description import Valve

from .record_loading import (
    Recording,
    Selection,
    channel_faults,
    load_recording,
    load_recordings,
    outliers_text,
    stretches_of,
)

Array = NDArray[np.float64]

#: s, below which a stretch is no use: settling of the filters, run-in, and something to fit.
SHORTEST = 2.0
#: How far a spectrum must stand out of its median to be motion: noise by itself stays below 6.
STANDS_OUT = 10.0
#: s of the pieces that are held out, at least, and one piece of how many is.
PIECE, EVERY = 2.5, 4
#: Pieces a record is divided into at most.
PIECES = 8


@dataclass(frozen=True, slots=True)
class FitData:
    """Fit data: records of one valve.

    Attributes:
        name: of the whole, for tables.
        paths: what was read.
        valve: what all of it is of.
        fitted: stretches that parameters come from.
        held_out: stretches that errors are validated by, empty where the records are too short for that.
        held_paths: records that were named to be held out; empty where pieces of the others are.
        doubts: what speaks against the valve's description, a sentence each.
    """

    name: str
    paths: tuple[Path, ...]
    valve: Valve
    fitted: tuple[Record, ...]
    held_out: tuple[Record, ...]
    held_paths: tuple[Path, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Length of the data that are fitted, s."""
        return sum(entry.duration for entry in self.fitted)


def load_data(
    paths: Sequence[Path], valve: str | None, selection: Selection, held_out: Sequence[Path] = ()
) -> FitData:
    """Return the records ``paths`` as one set of data of one valve.

    Args:
        paths: bags and CSV files.
        valve: as in ``load_recordings``.
        selection: what to take of each of ``paths``; of records held out all is taken.
        held_out: records to judge errors by; without any, pieces of ``paths`` are held out.

    Raises:
        InputError: unreadable, too short, or nothing moves in them.
    """
    recordings, described = load_recordings(paths, valve, selection)
    for recording in recordings:
        check(recording)
        for stretch in recording.stretches:
            check_rate(str(recording.path), stretch.sample_rate, described)
    records = stretches_of(recordings)
    name = ", ".join(path.name for path in paths)
    doubts = (*channel_doubts(recordings), *check_records(described, records))
    if not held_out:
        return FitData(name, tuple(paths), described, *divided(records), doubts=doubts)
    others: list[Record] = []
    for path in held_out:
        recording = load_recording(path, Selection(selection.name, selection.columns))
        check(recording)
        others += recording.stretches
    return FitData(name, tuple(paths), described, tuple(records), tuple(others), tuple(held_out), doubts)


def check(recording: Recording) -> None:
    """Refuse what nothing can be learnt from.

    Raises:
        InputError: no stretch is long enough, or neither body nor spool moves.
    """
    longest = max(stretch.duration for stretch in recording.stretches)
    if longest < SHORTEST:
        raise InputError(
            f"{recording.path}: its longest stretch without gaps has {longest:.2f} s: "
            f"a fit needs {SHORTEST:g} s at least"
        )
    if not any(excited(stretch) for stretch in recording.stretches if stretch.duration >= SHORTEST):
        raise InputError(
            f"{recording.path}: nothing but noise in both accelerations: without excitation there is nothing "
            "to fit; shake the body at 10 to 100 Hz"
        )


#: Causes without which no number of a fit means anything.
REFUSED = ("same_channel", "wrap_around", "repeats", "sensitivity", "clock_step")


def channel_doubts(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return what the samples show of sensors and clocks that a fit can bear, a sentence each.

    Raises:
        InputError: no fit can bear it; record, cause and remedy are named.
    """
    doubts = []
    for recording in recordings:
        name = recording.path.name
        if recording.left_out:
            doubts.append(f"{name}: {outliers_text(recording.left_out)}")
        for fault in channel_faults(recording.stretches):
            if fault.cause in REFUSED:
                raise InputError(f"{recording.path}: {fault.sentence}")
            doubts.append(f"{name}: {fault.sentence}")
    return tuple(doubts)


def excited(record: Record) -> bool:
    """Return whether something stands out of the noise in the body's or the spool's acceleration."""
    piece = min(record.body.size // 4, max(32, round(0.5 / record.sample_period)))
    for row in (record.body, record.spool):
        _, density = signal.welch(row, record.sample_rate, "hann", piece)
        median = float(np.median(density[1:]))
        if float(density[1:].max()) > STANDS_OUT * median:
            return True
    return False


def divided(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Return what is fitted and what is held out of ``records``: one piece in ``EVERY``, spread over each.

    A sweep passes every frequency once, so pieces are spread instead of cut off at an end. Where no record is
    long enough for that nothing is held out.
    """
    fitted: list[Record] = []
    held: list[Record] = []
    for entry in records:
        count = min(PIECES, int(entry.duration / PIECE))
        if count < EVERY:
            fitted.append(entry)
            continue
        edges = [entry.body.size * number // count for number in range(count + 1)]
        begin = 0
        for number in range(EVERY // 2, count, EVERY):
            fitted.append(entry.part(edges[begin], edges[number]))
            held.append(entry.part(edges[number], edges[number + 1]))
            begin = number + 1
        if begin < count:
            fitted.append(entry.part(edges[begin], entry.body.size))
    return tuple(fitted), tuple(held)
