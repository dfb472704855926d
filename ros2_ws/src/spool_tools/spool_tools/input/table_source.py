"""Record in a table read as if it were a bag: blocks and oil temperatures of one valve."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from spool_bag.importing.records.blocks import BLOCK_DURATION, start_of, stream_of
from spool_bag.reading.information import BagInformation, summarise
from spool_core.block import Block
from spool_core.block_run import BlockRun
from spool_core.format.cdr import OilTemperature

from .table_record import record_of_table


class TableSource:
    """Record in a logger's file, with what of :class:`spool_bag.reading.reader.BagReader` a replay needs.

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
        self.record = record_of_table(path, columns=columns)
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
        yield from stream_of(self.record, self._start)

    def runs(self, valve: str) -> Iterator[Block | BlockRun | OilTemperature]:
        """Yield what ``stream`` yields, as a bag's reader does."""
        yield from self.stream(valve)
