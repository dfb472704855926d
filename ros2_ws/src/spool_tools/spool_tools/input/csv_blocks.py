"""CSV record read as if it were a bag: blocks and oil temperatures of one valve."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from spool_bag.format.cdr import OilTemperature
from spool_bag.reading.information import BagInformation, summarise
from spool_bag.tables.csv_import import TEMPERATURE_INTERVAL, blocks_of, start_of
from spool_bag.tables.csv_record import OIL_TEMPERATURE, read_csv
from spool_stream.block import Block

#: s, as `import` cuts a record.
BLOCK_DURATION = 0.02


class CsvSource:
    """CSV record, with what of :class:`spool_bag.reading.reader.BagReader` a replay needs.

    Attributes:
        path: the file.
        valves: its only valve has the name that `import` gives by default.
        warnings: what is not as it should be, one line each.

    Raises:
        InputError: the file is no record.
    """

    def __init__(self, path: Path, columns: Mapping[str, str] | None = None) -> None:
        self.path = path
        self.valves = ["valve_1"]
        self.record = read_csv(path, columns=columns)
        self.warnings = list(self.record.warnings)
        self._start = start_of(self.record)

    @property
    def count(self) -> int:
        """Number of blocks, about."""
        return math.ceil(self.record.time.size * self.record.period / BLOCK_DURATION)

    def describe(self) -> BagInformation:
        """Return what is in the file, as of a bag; it has no topics."""
        valve = summarise(self.valves[0], self.stream(self.valves[0]))
        return BagInformation(
            path=self.path,
            size=self.path.stat().st_size,
            closed=True,
            duration=valve.duration,
            first_stamp=valve.first_stamp,
            topics=(),
            valves=(valve,),
            damages=(),
            lost_messages=0,
            lost_estimated=False,
            undecodable={},
            warnings=tuple(self.warnings),
        )

    def stream(self, valve: str) -> Iterator[Block | OilTemperature]:
        """Yield blocks, and before each second of them the oil's temperature, as `import` writes them."""
        assert valve in self.valves
        oil = self.record.columns.get(OIL_TEMPERATURE)
        due = -1
        for first, block in blocks_of(self.record, self._start, BLOCK_DURATION):
            if oil is not None and block.stamp >= due and np.isfinite(oil[first]):
                yield OilTemperature(block.stamp, float(oil[first]))
                due = block.stamp + TEMPERATURE_INTERVAL
            yield block
