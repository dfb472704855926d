"""Settings beside the samples: each is applied, refused, or named as not used, whatever the format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_core.errors import InputError

from . import loggers as made

Beside = dict[str, object]


def npz(path: Path, body: object, spool: object, beside: Beside) -> Path:
    np.savez(
        path.with_suffix(".npz"),
        body=body,
        spool=spool,
        **{k.replace("/", "_"): v for k, v in beside.items()},
    )
    return path.with_suffix(".npz")


def mat(path: Path, body: object, spool: object, beside: Beside) -> Path:
    savemat(
        path.with_suffix(".mat"),
        {"body": body, "spool": spool, **{k.replace("/", "_"): v for k, v in beside.items()}},
    )
    return path.with_suffix(".mat")


def hdf5(path: Path, body: object, spool: object, beside: Beside) -> Path:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        for name, row in (("body", body), ("spool", spool)):
            file.create_dataset(name, data=row)
        for key, value in beside.items():
            at, _, name = key.rpartition("/")
            (file[at] if at else file).attrs[name] = value
    return path.with_suffix(".h5")


ARRAYS = [npz, mat, hdf5]
Maker = Callable[[Path, object, object, Beside], Path]
UNITS: Beside = {"body/unit": "m/s^2", "spool/unit": "m/s^2"}


def is_whole(found: LoggerRecord) -> bool:
    return (
        abs(found.period * made.RATE - 1.0) < 1e-6
        and np.allclose(found.columns["body_m_s2"], made.BODY, atol=1e-6)
        and np.allclose(found.columns["spool_m_s2"], made.SPOOL, atol=1e-6)
    )


@pytest.mark.parametrize("make", ARRAYS)
@pytest.mark.parametrize(
    "beside",
    [
        {"fs": made.RATE},
        {"fs": made.RATE / 1e3, "fs_unit": "kHz"},
        {"fs_kHz": made.RATE / 1e3},
        {"sample_rate": f"{made.RATE / 1e3} kHz"},
        {"dt": 1e3 / made.RATE, "dt_units": "ms"},
        {"body/fs": made.RATE / 1e3, "body/fs_unit": "kS/s"},
        {"isi": 1e3 / made.RATE, "isi_units": "ms"},
        {"FsUnit": "kHz", "Fs": made.RATE / 1e3},
        {"sampleRateHz": made.RATE},
        {"SampleRate_kHz": made.RATE / 1e3},
    ],
)
def test_the_unit_of_a_stated_rate_is_applied(tmp_path: Path, make: Maker, beside: Beside) -> None:
    assert is_whole(read_record(make(tmp_path / "x", made.BODY, made.SPOOL, {**UNITS, **beside})))


@pytest.mark.parametrize("make", ARRAYS)
def test_a_rate_in_an_unknown_unit_is_asked_for(tmp_path: Path, make: Maker) -> None:
    path = make(tmp_path / "x", made.BODY, made.SPOOL, {**UNITS, "fs": 2.0, "fs_unit": "per tick"})
    with pytest.raises(InputError, match="fs = 2 in per tick may be a sampling rate or not"):
        read_record(path)


@pytest.mark.parametrize("make", ARRAYS)
def test_scale_factor_offset_and_fill_value_are_applied(tmp_path: Path, make: Maker) -> None:
    stored = np.rint((made.BODY - 2.0) / 1e-4).astype(np.int32)
    stored[7] = -9_999_999
    beside = {
        **UNITS,
        "fs": made.RATE,
        "body/scale_factor": 1e-4,
        "body/add_offset": 2.0,
        "body/_FillValue": -9_999_999,
    }
    path = make(tmp_path / "x", stored, made.SPOOL, beside)
    found = read_record(path, how=choices(empty_as_gap=True))
    np.testing.assert_allclose(found.columns["body_m_s2"], np.delete(made.BODY, 7), atol=1e-4)


@pytest.mark.parametrize("make", ARRAYS)
@pytest.mark.parametrize("name", ["scale", "gain", "calibration_factor", "ScaleFactor"])
def test_whole_numbers_beside_a_factor_are_refused_and_others_name_it(
    tmp_path: Path, make: Maker, name: str
) -> None:
    stored = np.rint(made.BODY / 1e-4).astype(np.int32)
    beside = {**UNITS, "fs": made.RATE, f"body/{name}": 1e-4}
    path = make(tmp_path / "x", stored, made.SPOOL, beside)
    with pytest.raises(
        InputError, match=rf"body has whole numbers and body._?{name} = 0.0001.*--scale"
    ) as caught:
        read_record(path)
    assert "--scale 'body=0.0001m/s^2/count'" in str(caught.value) or "body=0.0001m/s^2/count" in str(
        caught.value
    )
    found = read_record(path, how=choices(unit="body=count", scale="body=0.0001m/s^2/count"))
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY, atol=1e-4)
    said = read_record(make(tmp_path / "y", made.BODY, made.SPOOL, beside)).notes
    assert any("not used" in one and name in one for one in said)


@pytest.mark.parametrize("make", ARRAYS)
@pytest.mark.parametrize(
    "starts",
    [
        {"spool/t0": 0.05},
        {"body/t0": 10.0, "spool/t0": 10.05},
        {"spool/t0": 50.0, "spool/t0_unit": "ms"},
        {"body/start_time": "2026-05-04T10:00:00Z", "spool/start_time": "2026-05-04T10:00:00.050Z"},
        {"body/start_time": 1.79e9, "spool/start_time": 1.79e9 + 0.05},
    ],
)
def test_channels_that_begin_at_different_times_are_aligned(
    tmp_path: Path, make: Maker, starts: Beside
) -> None:
    late = round(0.05 * made.RATE)
    path = make(tmp_path / "x", made.BODY[:-late], made.SPOOL[late:], {**UNITS, "fs": made.RATE, **starts})
    found = read_record(path)
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY[late:-late], atol=1e-4)
    np.testing.assert_allclose(found.columns["spool_m_s2"], made.SPOOL[late:-late], atol=1e-4)


@pytest.mark.parametrize("make", ARRAYS)
@pytest.mark.parametrize(
    ("name", "value"), [("n_samples", 2 * made.COUNT), ("duration", 2 * made.COUNT / made.RATE)]
)
def test_an_amount_that_is_stated_and_not_read_is_a_warning(
    tmp_path: Path, make: Maker, name: str, value: float
) -> None:
    found = read_record(make(tmp_path / "x", made.BODY, made.SPOOL, {**UNITS, "fs": made.RATE, name: value}))
    assert any(f"the file states {value:.7g}" in one for one in found.warnings)


@pytest.mark.parametrize("make", ARRAYS)
def test_what_is_stated_and_not_used_is_named(tmp_path: Path, make: Maker) -> None:
    beside = {**UNITS, "fs": made.RATE, "decimation": 10.0, "body/filter": "low-pass 200 Hz"}
    notes = "; ".join(read_record(make(tmp_path / "x", made.BODY, made.SPOOL, beside)).notes)
    assert "stated in the file and not used" in notes
    assert "decimation = 10" in notes
    assert "low-pass 200 Hz" in notes
    assert "fs =" not in notes
