"""Waterfalls that begin in what is recorded: the newest spectra, from any recording, also in a browser."""

from __future__ import annotations

import math
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter, PartLimits
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.errors import InputError
from spool_view.channels import BROKEN, FALL, PERIOD, waterfall_of
from spool_view.recorded import recorded_spectra

from .conftest import Domain, StandIn, until

BEGIN = 1_790_000_000
RATE, SIZE = 500.0, 50
#: Rows of the canvas that are no background.
LIT = """() => { const c = document.getElementById("waterfall");
    const d = c.getContext("2d").getImageData(0, 0, c.width, 120).data;
    let rows = 0; for (let y = 0; y < 120; y++) rows += d[4 * (y * c.width + 25) + 3] > 0; return rows; }"""


def recording(
    path: Path, seconds: Iterable[int], frequency: float, valve: str = "press/valve_1", **options: Any
) -> Path:
    """Write a recording whose spool swings with ``frequency`` (Hz) and an amplitude of 3 m/s^2."""
    per_second = round(RATE / SIZE)
    with BagWriter(path, **options) as writer:
        channel = writer.add_topic(f"/{valve}/acceleration", ACCELERATION_BLOCK)
        for number in (
            count for second in seconds for count in range(second * per_second, (second + 1) * per_second)
        ):
            clock = (number * SIZE + np.arange(SIZE)) / RATE
            spool = (3.0 * np.sin(2 * math.pi * frequency * clock)).astype(np.float32)
            stamp = round((BEGIN + number * SIZE / RATE) * 1e9)
            writer.write(
                channel, stamp, encode_block(Block(stamp, number, 1 / RATE, 0.5 * spool, spool), "valve")
            )
    return path


def lines(found: list[tuple[float, list[float]]]) -> list[float]:
    """Return the frequency (Hz) of the strongest line of each spectrum."""
    return [0.5 * int(np.argmax(spool)) for _, spool in found]


def test_the_last_minute_is_read_across_the_parts_of_a_recording(tmp_path: Path) -> None:
    bag = recording(tmp_path / "bag", range(90), 25.0, limits=PartLimits(duration=20.0))
    assert len(list(bag.glob("*.mcap"))) >= 4
    found = recorded_spectra(bag, "press/valve_1", FALL, PERIOD)
    assert len(found) == FALL
    assert found[-1][0] == pytest.approx(BEGIN + 90.0, abs=0.2)
    assert np.diff([seconds for seconds, _ in found]) == pytest.approx(PERIOD, abs=0.11)
    assert set(lines(found)) == {25.0}
    assert max(found[-1][1]) == pytest.approx(3.0, rel=0.01)


def test_the_newest_recording_of_that_valve_counts_in_a_folder_of_recordings(tmp_path: Path) -> None:
    old = recording(tmp_path / "old", range(10), 25.0)
    new = recording(tmp_path / "new", range(60, 70), 40.0)
    other = recording(tmp_path / "other", range(80, 90), 60.0, valve="press/valve_2")
    for age, bag in ((300, old), (200, new), (100, other)):
        for part in bag.glob("*.mcap"):
            os.utime(part, (BEGIN - age, BEGIN - age))
    found = lines(recorded_spectra(tmp_path, "press/valve_1", FALL, PERIOD))
    assert set(found) == {25.0, 40.0}
    assert found == sorted(found)
    assert recorded_spectra(tmp_path, "press/valve_3", FALL, PERIOD) == []


def test_a_recording_that_was_cut_off_and_damaged_gives_what_is_whole(tmp_path: Path) -> None:
    bag = recording(tmp_path / "bag", range(30), 25.0, flush_interval=0.0)
    (part,) = bag.glob("*.mcap")
    content = bytearray(part.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 500] = bytes(500)
    part.write_bytes(content[: len(content) * 9 // 10])
    found = recorded_spectra(bag, "press/valve_1", FALL, PERIOD)
    assert 30 < len(found) < FALL
    assert set(lines(found)) == {25.0}


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"bags: .*nowhere: no such folder"):
        recorded_spectra(tmp_path / "nowhere", "press/valve_1", FALL, PERIOD)


def test_missing_time_is_an_empty_line_and_the_last_time_before_it_is_named() -> None:
    fall = deque([(BEGIN + 0.0, [1.0]), (BEGIN + 0.5, [2.0]), (BEGIN + 0.6 + BROKEN, [3.0])])
    found = waterfall_of(fall, BEGIN + 4.0)
    assert (found["spool"], found["until"]) == ([[1.0], [2.0], [], [3.0]], BEGIN)
    assert waterfall_of(deque([(BEGIN + 0.0, [1.0])]), BEGIN + 1.0) == {
        "step": 0.5,
        "spool": [[1.0]],
        "until": None,
    }


def test_after_a_restart_the_waterfall_shows_what_the_recorder_wrote(
    domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any], tmp_path: Path
) -> None:
    """Real simulator and recorder, whose recording is under way; the page's server never saw a sample."""
    stand_in()
    bag = tmp_path / "bags" / "recording"
    domain.start("spool_bag", "recorder", output=bag)
    simulator = domain.start(
        "spool_sim", "simulator", "-r", "__ns:=/valve_1", excitation="multisine", wait_for_subscribers=1
    )

    def recorded() -> int:
        try:
            return BagReader(bag, skip_damage=True).blocks_of("valve_1")
        except InputError:  # not begun yet
            return 0

    until(lambda: recorded() >= 200, "four seconds are recorded")
    simulator.send_signal(signal.SIGKILL)

    def age() -> float:
        return time.time() - recorded_spectra(bag.parent, "valve_1", FALL, PERIOD)[-1][0]

    until(lambda: age() > BROKEN, "data are missing")
    _, address = domain.page(bags=bag.parent)
    page = open_page(f"{address}valve/valve_1", locale="en-GB")
    page.click("summary:has(#h_waterfall)")
    until(lambda: page.evaluate(LIT) >= 4, "recorded spectra are drawn")
    page.wait_for_selector("#waterfall_text >> text=Data are missing at each white line")
    assert page.query_selector("#spectrum canvas") is None
