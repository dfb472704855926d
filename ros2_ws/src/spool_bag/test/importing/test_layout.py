"""What stands around the samples of a text or workbook: names, units, settings, holes, and a file's end."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_bag.importing.choices import choices
from spool_bag.importing.csv_cells import is_grouped
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_core.errors import InputError

from . import loggers as made

ROWS = made.rows().splitlines()
GERMAN = made.rows(",", ";").splitlines()
NO_TIME = [row.partition(",")[2] for row in ROWS]
CONTRACT = "time_s,body_m_s2,spool_m_s2"


def save(folder: Path, lines: list[str], encoding: str = "utf-8", *, end: str = "\n") -> Path:
    path = folder / "record.csv"
    path.write_bytes(("\n".join(lines) + end).encode(encoding))
    return path


def check(found: LoggerRecord, count: int = made.COUNT) -> None:
    """Check that the samples are those of the motion, from its first one on."""
    assert found.period == pytest.approx(1.0 / made.RATE, rel=1e-6)
    assert found.time.size == count
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY[:count], atol=1e-6)
    np.testing.assert_allclose(found.columns["spool_m_s2"], made.SPOOL[:count], atol=1e-6)


SI = ["s,m/s2,m/s2"]
ABOVE: list[tuple[str, list[str], list[str], dict[str, object]]] = [
    ("unit of another quantity", ["Time,Body,Spool,P", "s,m/s^2,m/s^2,bar"], [f"{r},99.5" for r in ROWS], {}),
    ("unknown unit", ["Time,Body,Spool,n", "s,m/s²,m/s²,furlong"], [f"{r},99.5" for r in ROWS], {}),
    ("speed", ["Time,Body,Spool,n", "[s],[m/s²],[m/s²],[1/min]"], [f"{r},1450" for r in ROWS], {}),
    ("dash for no unit", ["Time,Body,Spool,state", "s,ms-2,ms-2,-"], [f"{r},1" for r in ROWS], {}),
    ("units above names", ["s,m/s2,m/s2", "Time,Body,Spool"], ROWS, {}),
    ("description below units", ["Time,Body,Spool", *SI, "clock,left side,left side"], ROWS, {}),
    ("numbers below names", ["Time,Body,Spool", *SI, "Range,50,50", "Offset,0.0,0.1"], ROWS, {}),
    ("keyed units", ["Name,Body,Spool", "Unit,m/s2,m/s2"], ROWS, {"columns": "time_s=Name"}),
    ("rate and names", ["Sampling rate [Hz],2000", "body [m/s2],spool [m/s2]"], NO_TIME, {}),
    ("rate in kHz", ["Abtastrate,2,kHz", "", "body [m/s2],spool [m/s2]"], NO_TIME, {}),
    ("interval", ["# dt = 0.5 ms", "body [m/s2],spool [m/s2]"], NO_TIME, {}),
    ("numbers in preamble", ["Samples,600,Channels", "4711,12,3", CONTRACT], ROWS, {}),
    ("channel numbers", ["2,3"], NO_TIME, {"columns": "body_m_s2=2,spool_m_s2=3", "rate": 2000.0}),
    ("channel numbers with time", ["t [s],1,2"], ROWS, {"columns": "body_m_s2=1,spool_m_s2=2"}),
    ("by number", ["t [s],a,b"], ROWS, {"columns": "time=#0,body_m_s2=#1,spool_m_s2=#2"}),
    ("names with commas", ['t [s],"a, left","b=x"'], ROWS, {"columns": "body_m_s2=a, left,spool_m_s2=#2"}),
    ("same names", ["t [s],a,a"], ROWS, {"columns": "body_m_s2=a_1,spool_m_s2=a_2"}),
    ("excluded", ["t [s],body [m/s2],spool [m/s2],body 2 [m/s2]"], [f"{r},1" for r in ROWS],
     {"exclude": "body 2"}),
    ("words of times in preamble", ["Logger X,", "Start Time 08:58:00,", "Date 2/14/2026,", "Ch1,Ch2"],
     NO_TIME, {"columns": "body_m_s2=Ch1,spool_m_s2=Ch2", "rate": 2000.0, "unit": "body=m/s^2,spool=m/s^2"}),
    ("extremes below names", [CONTRACT, "Max,8.118,3.127", "Min,-8.129,-3.125"], ROWS, {}),
    ("marked units", ["Time,Body,Spool", "s,m/(s^2)*,m/(s^2)*"], ROWS, {}),
    ("interval in words", ["Sampling time interval(ms),0.5", "body [m/s2],spool [m/s2]"], NO_TIME, {}),
    ("thousands in rate", ["Sampling rate: 2'000 Hz", "body [m/s2],spool [m/s2]"], NO_TIME, {}),
    ("rate with suffix", ["Sampling rate: 2k", "body [m/s2],spool [m/s2]"], NO_TIME, {}),
    ("numbers above samples", ["1680686620,1680686620", "32,32"], NO_TIME,
     {"columns": "body=#0,spool=#1", "rate": 2000.0, "unit": "body=m/s^2,spool=m/s^2"}),
    ("excluded number", [f"{CONTRACT},oil [degC]"],
     [f"{r},hot" for r in ROWS[:9]] + [f"{r},5" for r in ROWS[9:]], {"exclude": "#3"}),
    ("holes", [f"{CONTRACT},oil [degC]"],
     [f"{r},{h}" for r, h in zip(ROWS, ["45.0", "#N/A", "-", "", "n/a", "NaN"] * 100, strict=True)], {}),
]  # fmt: skip


@pytest.mark.parametrize(("above", "rows", "how"), [one[1:] for one in ABOVE], ids=[one[0] for one in ABOVE])
def test_what_stands_above_samples_is_no_sample(
    tmp_path: Path, above: list[str], rows: list[str], how: dict[str, object]
) -> None:
    check(read_record(save(tmp_path, above + rows), how=choices(**how)))


def test_holes_are_in_the_optional_column_alone(tmp_path: Path) -> None:
    rows = [f"{row},{'#N/A' if at == 5 else '45.0'}" for at, row in enumerate(ROWS)]
    found = read_record(save(tmp_path, [f"{CONTRACT},oil [degC]", *rows]))
    assert np.flatnonzero(np.isnan(found.columns["oil_temperature_C"])).tolist() == [5]
    bad = [*ROWS[:7], "0.0035,#N/A,1.0", *ROWS[8:]]
    path = save(tmp_path, [CONTRACT, *bad])
    with pytest.raises(InputError, match=r"line 9: body_m_s2 is empty, NaN.*--empty-as-gap"):
        read_record(path)
    left = read_record(path, how=choices(empty_as_gap=True))
    assert left.gaps.tolist() == [7]
    assert left.columns["spool_m_s2"].size == len(ROWS) - 1
    assert "1 row with values that are empty is left out" in left.warnings


@pytest.mark.parametrize("at", [0, 1, 2, 3, 300])
def test_a_bad_cell_is_refused_wherever_it_stands_and_no_sample_is_lost(tmp_path: Path, at: int) -> None:
    bad = [*ROWS[:at], f"{at / 2000:.4f},OVL,1.0", *ROWS[at + 1 :]]
    with pytest.raises(InputError, match=f"line {at + 2}: body_m_s2 is 'OVL', not a number"):
        read_record(save(tmp_path, [CONTRACT, *bad]))


def cut_line(text: bytes) -> bytes:
    return text[: text.rindex(b",") + 3]


END: list[tuple[str, Callable[[bytes], bytes], int, str]] = [
    ("line", lambda text: text[:-12], 599, "line 601"),
    ("number", cut_line, 599, "line 601"),
    ("NUL bytes", lambda text: text[:-12] + bytes(5000), 599, "NUL bytes from line 601"),
    ("NUL after a line", lambda text: text + bytes(100_000), 600, "NUL bytes"),
    ("footer", lambda text: text + b"\nMean,0.1,0.2\nEnd of file\n", 600, "2 lines from line 603"),
    ("footer of one cell", lambda text: text + b"[END]\n", 600, "line 602"),
    (
        "rows without a time",
        lambda text: text + b",8.118,3.127\n,0.1,0.2\n",
        600,
        "2 rows without a time, from line 602",
    ),
    ("no newline", lambda text: text[:-1], 600, ""),
]


@pytest.mark.parametrize(("change", "count", "said"), [one[1:] for one in END], ids=[one[0] for one in END])
def test_an_end_that_is_no_sample_costs_that_line_and_a_warning(
    tmp_path: Path, change: Callable[[bytes], bytes], count: int, said: str
) -> None:
    path = save(tmp_path, [CONTRACT, *ROWS])
    path.write_bytes(change(path.read_bytes()))
    found = read_record(path)
    check(found, count)
    assert said in " ".join(found.warnings)
    assert bool(found.warnings) == bool(said)


@given(st.integers(2000, 16_000), st.sampled_from(["utf-8", "utf-16"]), st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_file_cut_anywhere_gives_the_samples_above_the_cut(
    tmp_path_factory: pytest.TempPathFactory, place: int, encoding: str, padded: bool
) -> None:
    path = save(tmp_path_factory.mktemp("cut"), [CONTRACT, *ROWS], encoding)
    place = place // 2 * 2
    text = path.read_bytes()[:place]
    path.write_bytes(text + bytes(4096 if padded and encoding == "utf-8" else 0))
    whole = text.decode(encoding, "ignore").split("\n")[1:]
    count = len(whole) - (0 if whole[-1] == ROWS[min(len(whole), made.COUNT) - 1] else 1)
    check(read_record(path), count)


def test_nul_bytes_between_samples_are_refused(tmp_path: Path) -> None:
    path = save(tmp_path, [CONTRACT, *ROWS])
    text = path.read_bytes()
    path.write_bytes(text[:9000] + bytes(50) + text[9050:])
    with pytest.raises(InputError, match=r"binary file|NUL bytes and text follows"):
        read_record(path)


def test_marks_between_thousands_are_read_where_they_are_sure_and_refused_else(tmp_path: Path) -> None:
    def grouped(value: float) -> str:
        return f"{round(1e3 * value):,}".replace(",", ".")

    rows = [
        f"{t:.4f};{b};{s}".replace(f"{t:.4f}", f"{t:.4f}".replace(".", ","))
        for t, b, s in zip(made.TIME, map(grouped, made.BODY), map(grouped, made.SPOOL), strict=True)
    ]
    found = read_record(save(tmp_path, ["t [s];body [mm/s²];spool [mm/s²]", *rows]))
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY, atol=6e-4)
    alone = [row.partition(";")[2] for row in rows]
    with pytest.raises(InputError, match=r"holds -?\d+\.\d{3} and -?\d+: is the mark one of thousands or of"):
        read_record(save(tmp_path, ["body [mm/s²];spool [mm/s²]", *alone]), how=choices(rate=2000.0))


@given(st.integers(-(10**9), 10**9), st.sampled_from([".", ","]))
@settings(max_examples=200)
def test_whole_numbers_with_marks_are_known_and_fractions_are_not_taken_for_them(
    number: int, decimal: str
) -> None:
    other = "," if decimal == "." else "."
    assert is_grouped(f"{number:,}".replace(",", other), decimal) == (abs(number) >= 1000)
    assert not is_grouped(f"{number / 1e4:.4f}".replace(".", other), decimal)
    assert not is_grouped(f"0{other}{abs(number) % 1000:03d}", decimal)


ENCODED = [
    ("gbk", "GBK", "时间 [s],阀体 [m/s2],阀芯 [m/s2]"),
    ("shift_jis", "Shift-JIS", "時間 [s],ボディ [m/s2],スプール [m/s2]"),
    ("cp1251", "Windows-1251", "Время [с],Корпус [м/с2],Золотник [м/с2]"),
    ("cp1252", "Windows-1252", "Zeit [s],Gehäuse [m/s²],Schieber [m/s²]"),
]


@pytest.mark.parametrize(("encoding", "name", "header"), ENCODED, ids=[one[0] for one in ENCODED])
def test_an_encoding_is_recognised_and_named(tmp_path: Path, encoding: str, name: str, header: str) -> None:
    how = choices(columns="body_m_s2=#1") if encoding == "shift_jis" else None
    found = read_record(save(tmp_path, [header, *ROWS], encoding), how=how)
    check(found)
    assert f"text assumed to be {name}" in " ".join(found.notes)


def workbook(folder: Path, *rows: list[object]) -> Path:
    import openpyxl  # noqa: PLC0415 - slow to load

    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.save(folder / "book.xlsx")
    return folder / "book.xlsx"


def test_a_workbook_has_the_same_rules(tmp_path: Path) -> None:
    above = [["Sampling rate [Hz]", 2000], ["Operator", "rig 2"], [], ["Body", "Spool", "Oil"]]
    samples = [
        [float(b), f"{s:.4f}".replace(".", ","), "#N/A" if at == 3 else 45.0]
        for at, (b, s) in enumerate(zip(made.BODY, made.SPOOL, strict=True))
    ]
    found = read_record(workbook(tmp_path, *above, ["m/s2", "m/s2", "degC"], *samples))
    check(found)
    assert "Sampling rate" in " ".join(found.notes)
    assert np.isnan(found.columns["oil_temperature_C"][3])


def test_other_columns_of_a_workbook_refuse_nothing_and_times_may_be_text(tmp_path: Path) -> None:
    samples = [
        [
            f"2026-05-04T10:00:{at / made.RATE:09.6f}", float(b), float(s),
            "ok" if at % 9 == 0 else 1, None, 1.5 if at < 99 else "end",
        ]
        for at, (b, s) in enumerate(zip(made.BODY, made.SPOOL, strict=True))
    ]  # fmt: skip
    head = ["Timestamp", "Body (m/s^2)", "Spool (m/s^2)", "State", None, "Mean"]
    path = workbook(tmp_path, head, *samples)
    found = read_record(path)
    check(found)
    assert found.start == 1_777_888_800_000_000_000
    with pytest.raises(InputError, match="row 2: State is 'ok', not a number"):
        read_record(path, columns={"body_m_s2": "State"})


def test_elapsed_times_of_a_workbook_are_times(tmp_path: Path) -> None:
    samples = [
        [timedelta(milliseconds=at), float(b), float(s)]
        for at, (b, s) in enumerate(zip(made.BODY, made.SPOOL, strict=True))
    ]
    found = read_record(workbook(tmp_path, ["Elapsed", "Body (m/s^2)", "Spool (m/s^2)"], *samples))
    assert found.period == pytest.approx(1e-3, rel=1e-6)
    np.testing.assert_allclose(found.columns["spool_m_s2"], made.SPOOL)


def test_each_conversion_is_described(tmp_path: Path) -> None:
    rows = [
        f"{1e3 * t:.1f},{b:.4f},{1e3 * s:.1f},104.0"
        for t, b, s in zip(made.TIME, made.BODY, made.SPOOL, strict=True)
    ]
    path = save(tmp_path, ["Zeit [ms],x [g],Schieber [mV],Öl [°F]", *rows])
    found = read_record(path, how=choices(columns="body=#1", scale="spool=100mV/g"))
    assert [str(use) for use in found.uses] == [
        "time: column #0 'Zeit [ms]', 1 ms = 0.001 s",
        "body: column #1 'x [g]', 1 g = 9.80665 m/s^2",
        "spool: column #2 'Schieber [mV]', 1 mV = 0.0980665 m/s^2 (--scale spool=100mV/g)",
        "oil: column #3 'Öl [°F]', °F converted to degC",
    ]
    np.testing.assert_allclose(found.columns["body_m_s2"], 9.80665 * made.BODY, atol=1e-3)
    np.testing.assert_allclose(found.columns["oil_temperature_C"], 40.0, atol=1e-9)
    over = read_record(path, how=choices(columns="body=#1", scale="spool=100mV/g", unit="body=m/s^2"))
    assert str(over.uses[1]).endswith("in m/s^2 (--unit body=m/s^2 instead of the file's g)")


@pytest.mark.parametrize(
    ("setting", "why"),
    [
        ("Rate: 25", "'Rate', line 1 may be a sampling rate or not: if it is, type --rate 25"),
        ("Data rate: 115200", "'Data rate', line 1 may be a sampling rate or not"),
        ("Sample Rate: 51,200 Hz", "type --rate 51200, or --rate 51.2"),
        ("Samples: 700", "no sampling rate in it"),
        ("Sample interval: 1,250 ms", "type --rate 0.8, or --rate 800"),
    ],
)
def test_a_setting_that_may_be_another_rate_is_asked_for(tmp_path: Path, setting: str, why: str) -> None:
    path = save(tmp_path, [setting, "body [m/s2],spool [m/s2]", *NO_TIME])
    with pytest.raises(InputError, match=why):
        read_record(path)
    check(read_record(path, how=choices(rate=2000.0)))


def test_lines_above_the_samples_that_nothing_used_are_named(tmp_path: Path) -> None:
    above = ["Decimation: 10", "Operator;Eva", "Sampling rate [Hz];2000", "body [m/s2];spool [m/s2]"]
    found = read_record(save(tmp_path, [*above, *(row.partition(";")[2] for row in GERMAN)]))
    assert "stated in the file and not used: Decimation = 10, Operator = Eva" in found.notes


@pytest.mark.parametrize("count", ["{:04X}", "0x{:04X}"])
def test_hexadecimal_counts_are_refused_as_that(tmp_path: Path, count: str) -> None:
    rows = [f"{at},{count.format(0x400 + 7 * at)},{count.format(0xC00 - 5 * at)}" for at in range(200)]
    with pytest.raises(InputError, match="hexadecimal numbers of unknown sign"):
        read_record(save(tmp_path, ["sample,body [g],spool [g]", *rows]), how=choices(rate=2000.0))


def test_counts_that_may_be_hexadecimal_by_their_zeros_are_named(tmp_path: Path) -> None:
    rows = [f"{at},{300 + at % 10:04d},{300 + at % 7:04d}" for at in range(200)]
    found = read_record(save(tmp_path, ["sample,body [g],spool [g]", *rows]), how=choices(rate=2000.0))
    assert any(
        "body [g] is read as decimal numbers, and may hold hexadecimal" in one for one in found.warnings
    )


def test_a_filter_of_the_spool_alone_is_named(tmp_path: Path) -> None:
    above = ["Spool bandwidth: 50 Hz", "Body bandwidth: 500 Hz"]
    header = "t [s],body [m/s^2],spool [m/s^2]"
    found = read_record(save(tmp_path, [*above, header, *ROWS]))
    assert any(
        "filtered or decimated differently (body: bandwidth = 500 Hz, spool: bandwidth = 50 Hz)" in one
        for one in found.warnings
    )
    alike = read_record(save(tmp_path, [above[1], above[1].replace("Body", "Spool"), header, *ROWS]))
    assert not any("differently" in one for one in alike.warnings)


def test_rows_of_a_slower_channel_are_said_to_decimate_the_faster_one(tmp_path: Path) -> None:
    rows = [row if at % 10 == 0 else f"{row.rpartition(',')[0]}," for at, row in enumerate(ROWS)]
    found = read_record(save(tmp_path, [CONTRACT, *rows]), how=choices(empty_as_gap=True))
    assert any("all but every 10th: what was sampled faster is decimated" in one for one in found.warnings)


@pytest.mark.parametrize("end", ["\r", "\r\n"])
@pytest.mark.parametrize("name", ["record.log", "record.ascii", "record"])
def test_a_text_is_read_whatever_its_name_and_ends_of_lines(tmp_path: Path, name: str, end: str) -> None:
    (tmp_path / name).write_bytes("".join(f"{row}{end}" for row in [CONTRACT, *ROWS]).encode())
    check(read_record(tmp_path / name))


def test_readings_without_a_unit_are_in_no_unit_that_a_sensitivity_has(tmp_path: Path) -> None:
    path = save(tmp_path, ["time_s,body,spool", *ROWS])
    with pytest.raises(InputError, match=r"could be in .*--unit body=V,spool=V"):
        read_record(path)
    scale = "body=1V/(m/s^2),spool=1V/(m/s^2)"
    with pytest.raises(InputError, match=r"does not state whether it is in V or mV.*--unit body=V"):
        read_record(path, how=choices(scale=scale))
    check(read_record(path, how=choices(scale=scale, unit="body=V,spool=V")))
    milli = read_record(path, how=choices(scale=scale, unit="body=mV,spool=mV"))
    np.testing.assert_allclose(milli.columns["body_m_s2"], 1e-3 * made.BODY, atol=1e-9)


@pytest.mark.parametrize("rows", ["in turn", "labelled in words"])
def test_rows_of_two_sensors_in_turn_are_refused(tmp_path: Path, rows: str) -> None:
    labels = ("1", "2") if rows == "in turn" else ("left", "right")
    lines = [
        f"{at / 2000:.4f},{label},{value:.4f},0.1"
        for at in range(made.COUNT)
        for label, value in zip(labels, (9.0 + made.BODY[at], made.SPOOL[at]), strict=True)
    ]
    path = save(tmp_path, ["time_s,sensor,x,y", *lines])
    with pytest.raises(InputError, match="rows of several sensors"):
        read_record(path, columns={"body_m_s2": "x", "spool_m_s2": "y"})
