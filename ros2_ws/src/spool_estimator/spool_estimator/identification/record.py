"""Record: a stretch of both accelerations without gaps, the data of every offline fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.errors import InputError

Array = NDArray[np.float64]


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
    known = [pair for pair in temperatures if np.isfinite(pair[1])]
    stamps, degrees = np.array([pair[0] for pair in known]), np.array([pair[1] for pair in known])
    records = []
    for stretch in stretches:
        first = stretch[0]
        body = np.concatenate([block.body for block in stretch]).astype(np.float64)
        oil = None
        if known:
            times = first.stamp + np.arange(body.size) * first.sample_period * 1e9
            oil = np.interp(times, stamps, degrees)
        records.append(
            Record(
                name,
                first.stamp,
                first.sample_period,
                body,
                np.concatenate([block.spool for block in stretch]).astype(np.float64),
                oil,
                stretches[0][0].stamp,
            )
        )
    return records
