"""Times as files state them: rates beside channels, clocks, starts, units, dates; right or refused."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
import pyuff
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat
from spool_bag.importing.bag_import import import_record
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_core.errors import InputError

RATE, COUNT = 2000.0, 1200
TIME = np.arange(COUNT) / RATE
BODY, SPOOL = np.random.default_rng(4).normal(0.0, 2.0, (2, COUNT)).round(4)
START = datetime(2026, 4, 5, 15, 2, 1, tzinfo=timezone.utc)


def mat(path: Path, **held: object) -> Path:
    savemat(path, held)
    return path


def csv(path: Path, header: str, *columns: Callable[[int], str]) -> Path:
    rows = (",".join(column(at) for column in columns) for at in range(COUNT))
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")
    return path


def body(at: int) -> str:
    return f"{BODY[at]:.4f}"


def spool(at: int) -> str:
    return f"{SPOOL[at]:.4f}"


def is_whole(found: LoggerRecord) -> bool:
    """Return whether a record holds all samples at their rate."""
    return (
        found.period == 1.0 / RATE
        and not found.gaps.size
        and np.allclose(found.columns["body_m_s2"], BODY)
        and np.allclose(found.columns["spool_m_s2"], SPOOL)
    )


UNITS = {"body_unit": "m/s^2", "spool_unit": "m/s^2"}


def test_the_rate_beside_the_channels_is_taken_and_named(tmp_path: Path) -> None:
    bearing = {"body": BODY, "spool": SPOOL, **UNITS, "sr": RATE, "rate": 25.0}
    found = read_record(mat(tmp_path / "x.mat", bearing=bearing, other={"fs": 50.0, "temp": np.arange(9.0)}))
    assert is_whole(found)
    assert "rate 2000 Hz from bearing/sr" in found.notes


def test_a_speed_alone_is_no_sampling_rate(tmp_path: Path) -> None:
    path = mat(tmp_path / "x.mat", bearing={"body": BODY, "spool": SPOOL, **UNITS, "rate": 25.0})
    with pytest.raises(InputError, match=r"bearing/rate = 25 may be a sampling rate or not"):
        read_record(path)
    assert is_whole(read_record(path, how=choices(rate=RATE)))


def test_settings_that_disagree_are_refused(tmp_path: Path) -> None:
    path = mat(tmp_path / "x.mat", rec={"body": BODY, "spool": SPOOL, **UNITS, "fs": RATE, "dt": 1e-3})
    with pytest.raises(
        InputError, match=r"rec/fs = 2000 Hz and rec/dt = 1000 Hz disagree: type .* --rate 2000"
    ):
        read_record(path)
    timed = mat(tmp_path / "t.mat", rec={"t": TIME, "body": BODY, "spool": SPOOL, **UNITS, "fs": 1000.0})
    with pytest.raises(InputError, match=r"rec/t shows 2000 Hz and rec/fs states 1000 Hz"):
        read_record(timed)
    assert is_whole(read_record(timed, how=choices(rate=RATE)))


def test_each_channel_has_the_rate_of_its_own_structure(tmp_path: Path) -> None:
    one = {"unit": "m/s^2", "fs": RATE}
    path = mat(
        tmp_path / "x.mat",
        body={**one, "data": BODY},
        spool={**one, "data": SPOOL},
        temp={"fs": 50.0, "data": np.arange(60.0)},
    )
    assert is_whole(read_record(path, how=choices(columns="body=body/data,spool=spool/data")))


def uff(path: Path, *sets: tuple[str, np.ndarray, dict[str, object]]) -> Path:
    for name, values, more in sets:
        pyuff.UFF(str(path)).write_sets(
            {
                "type": 58, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 1, "ref_dir": 1,
                "data": values, "x": TIME[: values.size], "id1": name, "abscissa_spacing": 1,
                "abscissa_min": 0.0, "abscissa_inc": 1.0 / RATE, "abscissa_spec_data_type": 17,
                "abscissa_axis_units_lab": "s", "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0,
                "ordinate_axis_units_lab": "m/s^2", **more,
            },
            "add",
        )  # fmt: skip
    return path


def test_an_abscissa_in_milliseconds_is_converted_and_one_in_degrees_refused(tmp_path: Path) -> None:
    slow = {"abscissa_axis_units_lab": "ms", "abscissa_inc": 0.5, "x": 1e3 * TIME}
    path = uff(tmp_path / "ms.uff", ("body", BODY, slow), ("spool", SPOOL, slow))
    found = read_record(path)
    assert found.period == pytest.approx(5e-4)
    assert "rate 2000 Hz from abscissa increment" in found.notes
    turning = {"abscissa_axis_units_lab": "deg"}
    path = uff(tmp_path / "deg.uff", ("body", BODY, turning), ("spool", SPOOL, turning))
    with pytest.raises(InputError, match=r"it has body over deg, spool over deg: export time signals"):
        read_record(path)


def test_channels_that_start_apart_share_their_common_part(tmp_path: Path) -> None:
    path = uff(
        tmp_path / "x.uff", ("body", BODY, {}), ("spool", SPOOL, {"abscissa_min": 0.1, "x": TIME + 0.1})
    )
    found = read_record(path)
    np.testing.assert_allclose(found.columns["body_m_s2"], BODY[200:], atol=1e-6)
    np.testing.assert_allclose(found.columns["spool_m_s2"], SPOOL[:-200], atol=1e-6)
    path = tmp_path / "x.tdms"
    with TdmsWriter(path) as writer:
        for name, values, late in (("body", BODY, 0.0), ("spool", SPOOL, 0.1)):
            held = {"unit_string": "m/s^2", "wf_increment": 1.0 / RATE, "wf_start_offset": late}
            writer.write_segment([ChannelObject("g", name, values, properties=held)])
    found = read_record(path)
    np.testing.assert_allclose(found.columns["body_m_s2"], BODY[200:], atol=1e-9)
    np.testing.assert_allclose(found.columns["spool_m_s2"], SPOOL[:-200], atol=1e-9)


def test_an_uneven_abscissa_keeps_its_gap(tmp_path: Path) -> None:
    late = {
        "abscissa_spacing": 0,
        "abscissa_inc": 0.0,
        "x": np.where(np.arange(COUNT) < 500, TIME, TIME + 0.5),
    }
    found = read_record(uff(tmp_path / "x.uff", ("body", BODY, late), ("spool", SPOOL, late)))
    assert found.gaps.tolist() == [500]
    assert found.duration == pytest.approx(COUNT / RATE + 0.5)


def test_values_that_are_marked_as_invalid_are_a_gap_in_both_channels(tmp_path: Path) -> None:
    from asammdf import MDF, Signal  # noqa: PLC0415 - slow to load

    invalid = {"body": np.zeros(COUNT, bool), "spool": np.zeros(COUNT, bool)}
    invalid["body"][300:310] = invalid["spool"][700:705] = True
    with MDF(version="4.10") as file:
        file.append(
            [
                Signal(values, TIME, unit="m/s^2", name=name, invalidation_bits=invalid[name])
                for name, values in (("body", BODY), ("spool", SPOOL))
            ]
        )
        file.save(tmp_path / "x.mf4")
    found = read_record(tmp_path / "x.mf4")
    valid = ~(invalid["body"] | invalid["spool"])
    np.testing.assert_array_equal(found.columns["body_m_s2"], BODY[valid])
    np.testing.assert_array_equal(found.columns["spool_m_s2"], SPOOL[valid])
    np.testing.assert_allclose(found.time, TIME[valid], atol=1e-9)
    assert "15 rows with values that the file marks as invalid are left out" in found.warnings


def test_whole_seconds_and_a_column_of_milliseconds_are_one_time(tmp_path: Path) -> None:
    path = csv(
        tmp_path / "x.csv", "Time,ms,body_m_s2,spool_m_s2",
        lambda at: f"03:02:{1 + at // 1000:02d}", lambda at: str(at % 1000), body, spool,
    )  # fmt: skip
    found = read_record(path)
    assert (found.period, found.gaps.size, found.start) == (1e-3, 0, None)
    assert any("has no date: the record begins on 2025-01-01" in note for note in found.notes)


def test_two_columns_of_time_are_one_clock_or_refused_with_what_to_type(tmp_path: Path) -> None:
    first, same = (lambda at: f"{TIME[at]:.6f}"), (lambda at: f"{1e3 * TIME[at]:.4f}")
    path = csv(tmp_path / "a.csv", "t [s],t2 [ms],body [m/s^2],spool [m/s^2]", first, same, body, spool)
    assert is_whole(read_record(path))
    late = csv(
        tmp_path / "c.csv", "t [s],body [m/s^2],t2 [s],spool [m/s^2]",
        first, body, lambda at: f"{TIME[at] + 1.0:.6f}", spool,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"are two clocks, 1 s apart: .* type --exclude"):
        read_record(late)
    drifting = csv(
        tmp_path / "b.csv", "T1,spool [m/s^2],T11,body [m/s^2]",
        first, spool, lambda at: f"{TIME[at] * 1.0008:.6f}", body,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"are two clocks, they move apart by .* type --exclude T11$"):
        read_record(drifting, how=choices(columns="time_s=T1"))
    assert is_whole(read_record(drifting, how=choices(columns="time=T1", exclude="T11", unit="time=s")))


def moment(at: int) -> datetime:
    return START + timedelta(seconds=float(TIME[at]))


def seconds(shift: float) -> Callable[[int], str]:
    return lambda at: f"{TIME[at] + 1.0 + shift:.6f}"


def dates(shift: float) -> Callable[[int], str]:
    return lambda at: (moment(at) + timedelta(seconds=shift)).strftime("%Y-%m-%d %H:%M:%S.%f")


@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["earlier", "later"])
@pytest.mark.parametrize(("written", "unit"), [(seconds, " [s]"), (dates, "")], ids=["seconds", "dates"])
def test_two_columns_of_time_that_begin_half_a_sample_apart_are_two_clocks(
    tmp_path: Path, written: Callable[[float], Callable[[int], str]], unit: str, side: float
) -> None:
    """They may differ by a quarter of a sample."""

    def record(samples: float) -> LoggerRecord:
        header = f"time{unit},body [m/s^2],time_2{unit},spool [m/s^2]"
        second = written(side * samples / RATE)
        return read_record(csv(tmp_path / f"{samples}.csv", header, written(0.0), body, second, spool))

    assert is_whole(record(0.2))
    with pytest.raises(InputError, match=r"are two clocks, 0\.00025 s apart"):
        record(0.5)


def test_a_time_rounded_to_two_samples_is_the_same_clock_as_the_exact_one(tmp_path: Path) -> None:
    header = "t [s],body [m/s^2],t2 [s],spool [m/s^2]"
    path = csv(tmp_path / "x.csv", header, seconds(0.0), body, lambda at: f"{TIME[at] + 1.0:.3f}", spool)
    assert is_whole(read_record(path))


def test_dates_and_seconds_of_one_clock_are_one_time_though_they_count_from_different_moments(
    tmp_path: Path,
) -> None:
    path = csv(
        tmp_path / "x.csv", "t [s],Date,body [m/s^2],spool [m/s^2]", seconds(0.0), dates(0.0), body, spool
    )
    found = read_record(path, how=choices(columns="time=t"))
    assert is_whole(found)
    assert found.start is not None
    assert found.start * 1e-9 + found.time[0] == pytest.approx(START.timestamp(), abs=1e-6)


DATES = {
    "iso": ("%Y-%m-%dT%H:%M:%S.%f", {}),
    "slashes_of_iso": ("%Y/%m/%d %H:%M:%S.%f", {}),
    "german": ("%d.%m.%Y %H:%M:%S.%f", {}),
    "matlab": ("%d-%b-%Y %H:%M:%S.%f", {}),
    "us": ("%m/%d/%Y %H:%M:%S.%f", {"dates": "mdy"}),
    "us_am_pm": ("%m/%d/%Y %I:%M:%S.%f %p", {"dates": "mdy"}),
    "uk": ("%d/%m/%Y %H:%M:%S.%f", {"dates": "dmy"}),
    "short_year": ("%d/%m/%y %H:%M:%S.%f", {"dates": "dmy"}),
    "dotted_year_first": ("%y.%m.%d %H:%M:%S.%f", {"dates": "ymd"}),
    "year_first": ("%y/%m/%d %H:%M:%S.%f", {"dates": "ymd"}),
}


@pytest.mark.parametrize("written", DATES)
def test_dates_are_read_as_they_are_written(tmp_path: Path, written: str) -> None:
    form, given = DATES[written]
    path = csv(
        tmp_path / "x.csv", "Time,body_m_s2,spool_m_s2", lambda at: moment(at).strftime(form), body, spool
    )
    if given:
        with pytest.raises(InputError, match=r"could begin with the .*: type --dates dmy, or --dates"):
            read_record(path)
    found = read_record(path, how=choices(**given))
    assert is_whole(found)
    assert found.start == round(START.timestamp()) * 1_000_000_000


def test_a_day_above_twelve_shows_the_order_of_a_date_beside_the_clock(tmp_path: Path) -> None:
    path = csv(
        tmp_path / "x.csv", "Date,Time,body_m_s2,spool_m_s2", lambda _: "04/25/2026",
        lambda at: moment(at).strftime("%I:%M:%S.%f %p"), body, spool,
    )  # fmt: skip
    found = read_record(path)
    assert found.start == round((START + timedelta(days=20)).timestamp()) * 1_000_000_000


@pytest.mark.parametrize(("zero", "kind"), [(25569.0, "Excel"), (719529.0, "MATLAB")])
def test_day_numbers_are_dates(tmp_path: Path, zero: float, kind: str) -> None:
    day = START.timestamp() / 86400.0 + zero
    path = csv(
        tmp_path / "x.csv",
        "time,body_m_s2,spool_m_s2",
        lambda at: f"{day + TIME[at] / 86400.0:.12f}",
        body,
        spool,
    )
    found = read_record(path)
    assert found.period == pytest.approx(1.0 / RATE, rel=1e-6)
    assert abs((found.start or 0) * 1e-9 - START.timestamp()) < 1e-4
    assert any(kind in note for note in found.notes)


def test_the_deviation_of_a_coarse_rate_stays_with_the_bag(tmp_path: Path) -> None:
    from spool_bag.metadata import rate_std  # noqa: PLC0415

    coarse = csv(
        tmp_path / "x.csv", "time_s,body_m_s2,spool_m_s2", lambda at: f"{at / 833.0:.3f}", body, spool
    )
    found = read_record(coarse)
    import_record(coarse, tmp_path / "bag")
    assert rate_std(tmp_path / "bag") == pytest.approx(found.rate_std, rel=1e-2)
    assert 1e-6 < found.rate_std < 1e-4
    even = csv(tmp_path / "y.csv", "time_s,body_m_s2,spool_m_s2", lambda at: f"{TIME[at]:.6f}", body, spool)
    import_record(even, tmp_path / "even")
    assert rate_std(tmp_path / "even") == 0.0


@pytest.mark.parametrize(("bits", "unit", "step"), [(32, "us", 500), (16, "us", 500), (24, "us", 500)])
def test_a_counter_of_microseconds_that_begins_again_is_continued(
    tmp_path: Path, bits: int, unit: str, step: int
) -> None:
    first = 2**bits - 100 * step
    path = csv(
        tmp_path / "x.csv",
        f"time_{unit},body (m/s^2),spool (m/s^2)",
        lambda at: str((first + at * step) % 2**bits),
        body,
        spool,
    )
    assert is_whole(read_record(path))


@pytest.mark.parametrize("rate", [None, RATE])
def test_two_runs_in_one_file_are_refused_whatever_rate_is_given(tmp_path: Path, rate: float | None) -> None:
    path = csv(
        tmp_path / "x.csv",
        "time (s),body (m/s^2),spool (m/s^2)",
        lambda at: f"{at % 600 / RATE:.4f}",
        body,
        spool,
    )
    with pytest.raises(InputError, match=r"does not increase .*two runs in one file"):
        read_record(path, how=choices(rate=rate))


def local(path: Path, first: str, zone: str = "") -> Path:
    begin = datetime.fromisoformat(first)
    return csv(
        path,
        "time,body [m/s^2],spool [m/s^2]",
        lambda at: f"{begin + timedelta(seconds=at / RATE):%d.%m.%Y %H:%M:%S.%f}{zone}",
        body,
        spool,
    )


@pytest.mark.parametrize(
    ("first", "zone", "utc", "said"),
    [
        (
            "2026-05-04 09:51:40",
            "Europe/Berlin",
            "2026-05-04 07:51:40",
            "09:51:40 in Europe/Berlin, 2026-05-04",
        ),
        ("2026-12-04 00:10:00", "Europe/Berlin", "2026-12-03 23:10:00", "2026-12-03 23:10:00 UTC, by time"),
        ("2026-12-04 09:51:40", "America/New_York", "2026-12-04 14:51:40", "in America/New_York, 2026"),
        (
            "2026-10-25 02:59:30",
            "Europe/Berlin",
            "2026-10-25 00:59:30",
            "(shown twice that night: the first is",
        ),
        ("2026-05-04 09:51:40", "", "2026-05-04 09:51:40", "09:51:40 UTC by time"),
    ],
)
def test_stamps_without_a_zone_are_of_the_zone_that_is_stated(
    tmp_path: Path, first: str, zone: str, utc: str, said: str
) -> None:
    found = read_record(local(tmp_path / "a.csv", first), how=choices(zone=zone))
    assert is_whole(found)
    assert found.start == int(np.datetime64(utc, "ns").astype(np.int64))
    assert sum(said in note for note in found.notes) == 1
    assert sum("the record begins" in note for note in found.notes) == 1


@pytest.mark.parametrize(
    ("first", "named", "said"),
    [
        ("2026-03-29 02:30:00", "", "clocks there never show 2026-03-29 02:30:00"),
        ("2026-03-29 01:59:59.900", "", "clocks there change during the record"),
        ("2026-05-04 09:51:40", "+02:00", "it has no dates without a zone: leave --zone out"),
        ("2026-05-04 09:51:40", "Z", "it has no dates without a zone: leave --zone out"),
    ],
)
def test_a_zone_that_cannot_hold_is_refused(tmp_path: Path, first: str, named: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_record(local(tmp_path / "a.csv", first, named), how=choices(zone="Europe/Berlin"))


def test_a_zone_is_for_dates_and_has_a_name(tmp_path: Path) -> None:
    seconds = csv(tmp_path / "a.csv", "time_s,body_m_s2,spool_m_s2", lambda at: f"{at / RATE}", body, spool)
    with pytest.raises(InputError, match="it has no dates without a zone"):
        read_record(seconds, how=choices(zone="Europe/Berlin"))
    counted = csv(tmp_path / "b.csv", "body_m_s2,spool_m_s2", body, spool)
    with pytest.raises(InputError, match="it has no column of times: leave --zone out"):
        read_record(counted, how=choices(zone="Europe/Berlin", rate=RATE))
    for wrong in ("Berlin", "CEST", "../etc/passwd", "+02:00"):
        with pytest.raises(InputError, match=r"--zone '.*': write a region and city, Europe/Berlin"):
            choices(zone=wrong)
