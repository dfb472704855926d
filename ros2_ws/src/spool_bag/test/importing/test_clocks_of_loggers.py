"""Times as loggers write them: read rightly, or asked for with every unit that fits; never a guessed rate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_core.errors import InputError

RATE, COUNT = 2000.0, 4000
TIME = np.arange(COUNT) / RATE
BODY, SPOOL = np.sin(90.0 * TIME), 2.0 * np.cos(90.0 * TIME) + 0.3
#: ns since 1970 of 2026-05-04 03:02:59.
MOMENT = 1_777_863_779_000_000_000


def written(path: Path, head: str, times: Callable[[int], str], *, turned: bool = False) -> Path:
    """Write the samples with ``head`` above and the time of each by its number."""
    rows = [f"{times(n)},{BODY[n]:.6f},{SPOOL[n]:.6f}" for n in range(COUNT)]
    path.write_text("\n".join([head, *(rows[::-1] if turned else rows)]) + "\n", "utf-8")
    return path


def known(record: LoggerRecord) -> None:
    assert 1.0 / record.period == pytest.approx(RATE, rel=1e-6)
    np.testing.assert_allclose(record.columns["body_m_s2"], BODY, atol=1e-5)
    np.testing.assert_allclose(record.columns["spool_m_s2"], SPOOL, atol=1e-5)


HEAD = "time,body (m/s^2),spool (m/s^2)"


def second(n: int) -> int:
    """Return the whole second, since 1970, of a sample."""
    return MOMENT // 10**9 + n // 2000


def of_day(n: int) -> str:
    """Return the time of day of a sample, whose minute ends after a second."""
    return f"03:0{2 + n // 2000}:{59 * (n < 2000) + n % 2000 / RATE:09.6f}"


SECONDS = {"secs_nsecs": "stamp.secs,stamp.nsecs", "sec_nanosec": "sec,nanosec"}
READ: dict[str, tuple[str, Callable[[int], str], int | None]] = {
    "net_ticks": ("time", lambda n: f"{(MOMENT + 500_000 * n) // 100 + 621_355_968_000_000_000}", MOMENT),
    "filetime": ("time", lambda n: f"{(MOMENT + 500_000 * n) // 100 + 116_444_736_000_000_000}", MOMENT),
    "labview": ("time", lambda n: f"{MOMENT // 10**9 + 2_082_844_800 + n / RATE:.4f}", MOMENT),
    "ticks_and_rate": ("# sampling rate: 2000 Hz\ntime", lambda n: f"{5000 * n}", None),
    "ticks_and_duration": ("# Num samples: 4000\n# Duration: 2 s\ntime", lambda n: f"{5000 * n}", None),
    "hhmmss": ("time", lambda n: of_day(n).replace(":", ""), None),
    **{name: (head, lambda n: f"{second(n)},{n % 2000 * 500_000}", MOMENT) for name, head in SECONDS.items()},
    "date_and_ms": ("Timestamp,elapsed_ms", lambda n: f"2026-05-04 {of_day(n)[:8]},{0.5 * n:.1f}", MOMENT),
    "epoch_and_s": ("epoch (ms),elapsed (s)", lambda n: f"{MOMENT // 10**6 + n // 2},{n / RATE:.4f}", MOMENT),
    "constant_first": ("begun,time", lambda n: f"2026-05-04T03:00:00,2026-05-04T{of_day(n)}", MOMENT),
}


@pytest.mark.parametrize("kind", READ)
def test_a_time_is_read_as_it_was_meant(kind: str, tmp_path: Path) -> None:
    head, times, start = READ[kind]
    record = read_record(written(tmp_path / "log.csv", HEAD.replace("time", head), times))
    known(record)
    if start is not None:
        begun = (record.start or 0) + round(1e9 * float(record.time[0]))
        assert begun == pytest.approx(start, abs=1e6)


@pytest.mark.parametrize(
    ("times", "asked"),
    [
        (lambda n: f"{5000 * n}", r"--unit time=us \(200 Hz\), or --unit time=100ns \(2000 Hz\)"),
        (lambda n: f"{n}", r"counts its samples, or could be in s or ms: .* type --rate"),
        (lambda n: f"{0.1 * n:.1f}", r"--unit time=s \(10 Hz\), or --unit time=ms \(1e\+04 Hz\)"),
        (
            lambda n: (
                f"{'2000-01-01' if n < 5 else '2026-05-04'}T03:02:0{n // 2000}.{500 * n % 1_000_000:06d}"
            ),
            "jumps by 9,6.. days: the clock was set",
        ),
    ],
    ids=["ticks", "counter", "ten_hertz", "clock_set"],
)
def test_a_time_that_could_be_several_is_asked_for(
    times: Callable[[int], str], asked: str, tmp_path: Path
) -> None:
    path = written(tmp_path / "log.csv", HEAD, times)
    with pytest.raises(InputError, match=asked):
        read_record(path)


def test_ticks_can_be_stated(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", HEAD, lambda n: f"{5000 * n}")
    known(read_record(path, how=choices(unit=["time=100ns"])))


def test_the_newest_row_may_stand_first(tmp_path: Path) -> None:
    path = written(
        tmp_path / "log.csv", HEAD.replace("time", "time_s"), lambda n: f"{n / RATE:.4f}", turned=True
    )
    known(read_record(path))


@pytest.mark.parametrize(
    "line", ["# Gain: 0.01", "# LSB = 0.01", "# Sensitivity: 0.01 m/s^2/LSB", "Resolution: 0.02"]
)
def test_whole_numbers_beside_a_factor_of_the_file_are_asked_about(line: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{n / RATE:.4f},{round(100 * BODY[n])},{round(100 * SPOOL[n])}" for n in range(COUNT)]
    path.write_text("\n".join([line, "time_s,body (m/s^2),spool (m/s^2)", *rows]) + "\n", "utf-8")
    with pytest.raises(InputError, match="whole numbers and the file states"):
        read_record(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [("-", "\u2212"), (",", "\u00a0,\u00a0"), (".", "0.")],
    ids=["minus", "no_break_spaces", "same"],
)
def test_marks_that_are_no_ascii_are_read(old: str, new: str, tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", HEAD.replace("time", "time_s"), lambda n: f"{n / RATE:.4f}")
    head, _, rest = path.read_text("utf-8").partition("\n")
    path.write_text(f"{head}\n{rest.replace(old, new) if old != '.' else rest}", "utf-8")
    known(read_record(path))
