"""Record: samples of both channels with their clock, and the parts that can be fitted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block, joined
from spool_core.block_gate import BlockGate, Verdict
from spool_core.errors import InputError
from spool_core.kernels.strokes import StrokeWatch
from spool_core.numbers import Array

#: Samples of both channels that are held at most.
LARGEST = 700_000
#: s, and samples at least, of a part.
PART, LEAST = 12.0, 4096


@dataclass(frozen=True, slots=True)
class Record:
    """Evenly spaced samples of both accelerometers, without gaps.

    Attributes:
        name: for messages and reports: the bag, the file.
        start: acquisition time of the first sample, ns.
        sample_period: s, > 0.
        body: acceleration of the body, m/s^2, shape (n,).
        spool: acceleration of the spool, same axis and sign, m/s^2, shape (n,).
        oil_temperature: deg C at each sample, shape (n,), or ``None`` where it is not known.
        origin: time at which t = 0 for laws that depend on time, ns; ``start`` unless given. Stretches of one
            recording share it.
        cut: it begins where something longer was cut, not after a gap.
        rate_std: relative standard deviation of the sampling rate; 0 where stamps show it to a millionth.
    """

    name: str
    start: int
    sample_period: float
    body: Array
    spool: Array
    oil_temperature: Array | None = None
    origin: int | None = None
    cut: bool = False
    rate_std: float = 0.0

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            InputError: shapes differ, or a sample or the period is not a number; the record is named.
        """
        shapes = {self.body.shape, self.spool.shape}
        if self.oil_temperature is not None:
            shapes.add(self.oil_temperature.shape)
        if len(shapes) != 1 or self.body.ndim != 1 or self.body.size < 1:
            raise InputError(f"{self.name}: body, spool and oil temperature must be rows of one length")
        if not (np.isfinite(self.sample_period) and self.sample_period > 0.0):
            raise InputError(f"{self.name}: sample period {self.sample_period:g} s must be a number > 0")
        for label, row in (("body", self.body), ("spool", self.spool)):
            bad = np.flatnonzero(~np.isfinite(row))
            if bad.size:
                raise InputError(
                    f"{self.name}: {label}: sample {bad[0]} is not a number ({bad.size} such in all); "
                    "cut the record there"
                )

    @property
    def duration(self) -> float:
        """Number of samples times their period, s."""
        return self.body.size * self.sample_period

    @property
    def sample_rate(self) -> float:
        """Hz."""
        return 1.0 / self.sample_period

    @property
    def first_sample(self) -> int:
        """Number of the first sample, counted from ``origin``."""
        origin = self.start if self.origin is None else self.origin
        return round((self.start - origin) * 1e-9 / self.sample_period)

    def part(self, first: int, stop: int) -> Record:
        """Return samples ``first`` to ``stop`` (exclusive); time keeps its origin."""
        temperature = self.oil_temperature
        return replace(
            self,
            start=self.start + round(first * self.sample_period * 1e9),
            body=self.body[first:stop],
            spool=self.spool[first:stop],
            oil_temperature=None if temperature is None else temperature[first:stop],
            origin=self.start if self.origin is None else self.origin,
        )


def without_strokes(record: Record, natural_frequency: float) -> tuple[list[Record], int]:
    """Return the parts of ``record`` between its strokes, and how many strokes there were.

    ``natural_frequency`` (Hz) is that of the description. A record without strokes is returned itself.
    """
    watch, count, at = StrokeWatch(), 0, 0
    size, parts = max(1, round(1.0 / record.sample_period)), [[0, 0]]
    body, spool = record.body.astype(np.float32), record.spool.astype(np.float32)
    for first in range(0, body.size, size):
        part = slice(first, first + size)
        block = Block(record.start, 0, record.sample_period, body[part], spool[part])
        for kept, pause in watch.kept(block, block, natural_frequency, restarts=first == 0):
            if pause is not None:
                at += round(pause * 1e-9 / record.sample_period)
                parts.append([at, at])
            at += kept.body.size
            parts[-1][1] = at
        count += len(watch.strokes)
    whole = parts == [[0, body.size]]
    return ([record] if whole else [record.part(*part) for part in parts if part[1] > part[0]]), count


def first_seconds(
    records: Sequence[Record], seconds: float, shortest: float = 0.0
) -> Iterator[tuple[int, Record]]:
    """Yield the first ``seconds`` s of ``records``: the number of a record and its beginning.

    A beginning has at least one sample: the time left over after the last one may be a fraction of a sample.
    Beginnings shorter than ``shortest`` s are skipped and take no time.
    """
    left = seconds
    for number, entry in enumerate(records):
        count = min(entry.body.size, round(left / entry.sample_period))
        if count < 1:
            return
        if count * entry.sample_period >= shortest:
            yield number, entry.part(0, count)
            left -= count * entry.sample_period


def records_from_blocks(
    blocks: Iterable[Block], name: str, temperatures: Iterable[tuple[int, float]] = ()
) -> list[Record]:
    """Return the stretches without gaps that ``blocks`` hold; faulty blocks are left out as online.

    Args:
        blocks: of one valve, in the order of their arrival.
        name: of the recording.
        temperatures: stamps (ns) and oil temperatures (deg C), in order of time; linear in between.
    """
    gate = BlockGate()
    stretches: list[list[Block]] = []
    for block in blocks:
        verdict = gate.judge(block)
        if verdict is Verdict.REFUSED:
            continue
        if verdict is Verdict.RESTARTS:
            stretches.append([])
        stretches[-1].append(block)
    known = _known(temperatures)
    records = []
    for whole in map(joined, stretches):
        start, period = whole.stamp, whole.sample_period
        body, spool = (row.astype(np.float64) for row in (whole.body, whole.spool))
        oil = _oil_at(known, start, period, body.size)
        records.append(Record(name, start, period, body, spool, oil, stretches[0][0].stamp))
    return records


@dataclass(slots=True)
class PartKeeper:
    """Takes blocks; holds all samples while they fit, else parts spread evenly over the whole time.

    Where ``largest`` is exceeded, long stretches are cut into parts of ``PART`` s, and of each two parts in a
    row the one with more motion stays; of what comes then one of two is kept, later one of four.

    Attributes:
        largest: samples that are held, about.
    """

    largest: int = LARGEST
    _gate: BlockGate = field(default_factory=BlockGate, init=False)
    _origin: int = field(default=0, init=False)
    _parts: list[_Part] = field(default_factory=list, init=False)
    _open: _Part | None = field(default=None, init=False)
    _rivals: list[_Part] = field(default_factory=list, init=False)
    _every: int = field(default=1, init=False)
    _came: int = field(default=0, init=False)
    _held: int = field(default=0, init=False)

    def take(self, block: Block) -> None:
        """Take the next block; a faulty one is left out as online."""
        verdict = self._gate.judge(block)
        if verdict is Verdict.REFUSED:
            return
        if self._open is None:
            self._origin = block.stamp
        fresh = verdict is Verdict.RESTARTS or self._open is None
        full = self._open is not None and self._every > 1 and self._open.size >= self._open.length
        if fresh or full:
            if self._open is not None:  # let it compete with those that came with it
                self._rivals = [_loudest([*self._rivals, self._open])] if self._every > 1 else []
                self._came += 1
                if self._came >= self._every:
                    self._parts += self._rivals or [self._open]
                    self._rivals, self._came = [], 0
                self._held = sum(part.size for part in (*self._parts, *self._rivals))
            self._open = _Part(block.stamp, block.sample_period, cut=not fresh)
        assert self._open is not None
        self._open.take(block)
        if self._held + self._open.size > self.largest:
            pieces = [piece for part in (*self._parts, *self._rivals) for piece in part.pieces()]
            *more, self._open = self._open.pieces()
            pieces += more
            self._parts = [_loudest(pieces[place : place + 2]) for place in range(0, len(pieces), 2)]
            self._rivals, self._came = [], 0
            self._every *= 2
            self._held = sum(part.size for part in self._parts)

    def records(self, name: str, temperatures: Iterable[tuple[int, float]] = ()) -> list[Record]:
        """Return what is held, in order of time.

        Args:
            name: of the recording.
            temperatures: stamps (ns) and oil temperatures (deg C), in order of time; linear in between.
        """
        known = _known(temperatures)
        found = []
        for part in (*self._parts, *self._rivals, *([] if self._open is None else [self._open])):
            body, spool = (np.concatenate(rows).astype(np.float64) for rows in (part.body, part.spool))
            oil = _oil_at(known, part.start, part.period, body.size)
            found.append(Record(name, part.start, part.period, body, spool, oil, self._origin, part.cut))
        return found


@dataclass(slots=True)
class _Part:
    """Samples without a gap; ``cut``: what is ahead of them was left out or lies in another part."""

    start: int
    period: float
    cut: bool
    body: list[NDArray[np.float32]] = field(default_factory=list)
    spool: list[NDArray[np.float32]] = field(default_factory=list)
    size: int = 0

    def take(self, block: Block) -> None:
        self.body.append(block.body)
        self.spool.append(block.spool)
        self.size += block.body.size

    @property
    def length(self) -> int:
        """Samples of a part of this sample period."""
        return max(round(PART / self.period), LEAST)

    def level(self) -> float:
        """Return the motion of the body, m/s^2 rms."""
        return float(np.concatenate(self.body).astype(np.float64).std())

    def pieces(self) -> list[_Part]:
        """Return this cut into parts of their length; the last may be shorter."""
        length = self.length
        if self.size <= length:
            return [self]
        body, spool = np.concatenate(self.body), np.concatenate(self.spool)
        found = []
        for first in range(0, self.size, length):
            piece = _Part(self.start + round(first * self.period * 1e9), self.period, self.cut or first > 0)
            part = slice(first, first + length)
            piece.body, piece.spool = [body[part].copy()], [spool[part].copy()]
            piece.size = piece.body[0].size
            found.append(piece)
        return found


def _loudest(parts: list[_Part]) -> _Part:
    """Return the part with most motion; a gap ahead of any of them is one ahead of it."""
    found = max(parts, key=_Part.level)
    found.cut = all(part.cut for part in parts)
    return found


def _known(temperatures: Iterable[tuple[int, float]]) -> Array:
    """Return stamps (ns) and temperatures (deg C) that are numbers, shape (2, n)."""
    return (
        np.array([pair for pair in temperatures if np.isfinite(pair[1])], dtype=np.float64).reshape(-1, 2).T
    )


def _oil_at(known: Array, start: int, period: float, count: int) -> Array | None:
    """Return the temperature of ``count`` samples, ``period`` s apart from ``start`` (ns) on."""
    return np.interp(start + np.arange(count) * period * 1e9, *known) if known.size else None
