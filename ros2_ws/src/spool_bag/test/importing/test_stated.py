"""Whatever a file of any format states is applied, refused, or named as not used: random files of each.

``SPOOL_DRAWN`` sets how many files are drawn.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pa_parquet
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
from scipy.io import savemat
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_core.errors import InputError

from . import loggers as made

RATE, COUNT = made.RATE, made.COUNT
DRAWN = int(os.environ.get("SPOOL_DRAWN", "60"))


@dataclass
class Content:
    """Content of a file: rows as they are stored, and what is stated of all of them and of each."""

    body: Any
    spool: Any
    whole: dict[str, Any] = field(default_factory=dict)
    own: dict[str, dict[str, Any]] = field(default_factory=dict)
    name: str = ""

    def stated(self) -> dict[str, Any]:
        """Return all settings by path."""
        return self.whole | {
            f"{name}/{key}": value for name, held in self.own.items() for key, value in held.items()
        }


def npz(path: Path, held: Content) -> None:
    np.savez(
        path, body=held.body, spool=held.spool, **{k.replace("/", "_"): v for k, v in held.stated().items()}
    )


def mat(path: Path, held: Content) -> None:
    flat = {key.replace("/", "_"): value for key, value in held.stated().items()}
    savemat(path, {"body": held.body, "spool": held.spool, **flat})


def mat_struct(path: Path, held: Content) -> None:
    parts = {name: {"data": getattr(held, name), **held.own.get(name, {})} for name in ("body", "spool")}
    savemat(path, {"rec": {**parts, **held.whole}})


def hdf5(path: Path, held: Content) -> None:
    with h5py.File(path, "w") as file:
        for name in ("body", "spool"):
            entry = file.create_dataset(f"rig/{name}", data=getattr(held, name))
            entry.attrs.update(held.own.get(name, {}))
        file["rig"].attrs.update(held.whole)


def parquet(path: Path, held: Content) -> None:
    def text(stated: dict[str, Any]) -> dict[str, str]:
        return {key: str(value) for key, value in stated.items()}

    size = min(held.body.size, held.spool.size)
    fields = [
        pa.field(name, pa.from_numpy_dtype(getattr(held, name).dtype), metadata=text(held.own.get(name, {})))
        for name in ("body", "spool")
    ]
    rows = [getattr(held, name)[:size] for name in ("body", "spool")]
    pa_parquet.write_table(pa.table(rows, schema=pa.schema(fields, metadata=text(held.whole))), path)


def tdms(path: Path, held: Content) -> None:
    with TdmsWriter(str(path)) as writer:
        channels = [
            ChannelObject("rig", name, getattr(held, name), held.own.get(name, {}))
            for name in ("body", "spool")
        ]
        writer.write_segment([RootObject({}), GroupObject("rig", held.whole), *channels])


def lines_of(held: Content) -> list[list[Any]]:
    unit = {name: stated.get("unit", "") for name, stated in held.own.items()}
    above = [[key, value] for key, value in held.whole.items()]
    above += [
        [f"{name} {key}", value]
        for name, own in held.own.items()
        for key, value in own.items()
        if key != "unit"
    ]
    names = [f"{name} [{unit[name]}]" if unit.get(name) else name for name in ("body", "spool")]
    size = min(len(held.body), len(held.spool))
    rows = zip(held.body[:size].tolist(), held.spool[:size].tolist(), strict=True)
    return [*above, names, *map(list, rows)]


def csv(path: Path, held: Content) -> None:
    path.write_text("".join(";".join(map(str, line)) + "\n" for line in lines_of(held)), "utf-8")


def excel(path: Path, held: Content) -> None:
    book = openpyxl.Workbook()
    for line in lines_of(held):
        book.active.append(line)
    book.save(path)


FORMATS: dict[str, Callable[[Path, Content], None]] = {
    "x.npz": npz, "x.mat": mat, "struct.mat": mat_struct, "x.h5": hdf5, "x.parquet": parquet, "x.tdms": tdms,
    "x.csv": csv, "x.xlsx": excel,
}  # fmt: skip

Change = Callable[[Content, Any], Content]


def stored(held: Content, factor: float, offset: float) -> Content:
    """Return a content whose body is stored as whole numbers."""
    return replace(held, body=np.rint((held.body - offset) / factor).astype(np.int32))


def of_body(held: Content, **stated: Any) -> Content:
    own = {**held.own, "body": {**held.own["body"], **stated}}
    return replace(held, own=own, name=next(iter(stated)))


def of_whole(held: Content, **stated: Any) -> Content:
    without = {key: value for key, value in held.whole.items() if key != "fs"}
    return replace(held, whole={**(without if "fs" in stated or "dt" in stated else held.whole), **stated})


def later(held: Content, count: int) -> Content:
    return replace(held, body=held.body[:-count], spool=held.spool[count:])


CHANGES: dict[str, tuple[st.SearchStrategy[Any], Change]] = {
    "rate_unit": (
        st.sampled_from([("Hz", 1.0), ("kHz", 1e3), ("kS/s", 1e3), ("MHz", 1e6), ("per turn", 1.0)]),
        lambda held, drawn: replace(of_whole(held, fs=RATE / drawn[1], fs_unit=drawn[0]), name="fs"),
    ),
    "period_unit": (
        st.sampled_from([("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ticks", 1.0)]),
        lambda held, drawn: replace(of_whole(held, dt=1.0 / RATE / drawn[1], dt_unit=drawn[0]), name="dt"),
    ),
    "scale_factor": (
        st.sampled_from([1e-4, 1e-3, 0.5e-4]),
        lambda held, drawn: of_body(stored(held, drawn, 0.0), scale_factor=drawn),
    ),
    "scale_and_offset": (
        st.floats(-5.0, 5.0),
        lambda held, drawn: of_body(stored(held, 1e-4, drawn), scale_factor=1e-4, add_offset=drawn),
    ),
    "other_scale": (
        st.sampled_from(
            ["scale", "gain", "slope", "multiplier", "calibration", "cal_factor", "conversion_factor"]
        ),
        lambda held, drawn: of_body(stored(held, 1e-3, 0.0), **{drawn: 1e-3}),
    ),
    "start": (
        st.tuples(st.sampled_from(["t0", "start_time", "wf_start_offset", "delay"]), st.integers(20, 200)),
        lambda held, drawn: replace(
            later(
                replace(held, own={**held.own, "spool": {**held.own["spool"], drawn[0]: drawn[1] / RATE}}),
                drawn[1],
            ),
            name=drawn[0],
        ),
    ),
    "moment": (
        st.integers(20, 200),
        lambda held, drawn: replace(
            later(held, drawn),
            own={
                "body": {**held.own["body"], "start_time": "2026-05-04T10:00:00.000000"},
                "spool": {**held.own["spool"], "start_time": f"2026-05-04T10:00:{drawn / RATE:09.6f}"},
            },
            name="start_time",
        ),
    ),
    "unit": (
        st.sampled_from(
            [("g", 9.80665), ("mg", 9.80665e-3), ("m/s^2", 1.0), ("mm/s²", 1e-3), ("mV", 1.0), ("foo", 1.0)]
        ),
        lambda held, drawn: of_body(replace(held, body=held.body / drawn[1]), unit=drawn[0]),
    ),
    "amount": (
        st.sampled_from(
            [("n_samples", COUNT + 50.0), ("duration", 2.0 * COUNT / RATE), ("number_of_samples", 7.0)]
        ),
        lambda held, drawn: replace(of_whole(held, **{drawn[0]: drawn[1]}), name=f"states {drawn[1]:.7g}"),
    ),
    "note": (
        st.tuples(
            st.sampled_from(
                ["decimation", "filter", "sensitivity", "comment", "range", "rig", "serial", "polarity"]
            ),
            st.one_of(st.floats(1.0, 1e6), st.text("abcdefgh ", min_size=3, max_size=20).filter(str.strip)),
        ),
        lambda held, drawn: replace(of_whole(held, **{drawn[0]: drawn[1]}), name=drawn[0]),
    ),
}


def outcome(found: LoggerRecord, name: str, rate: float = RATE) -> tuple[bool, bool]:
    """Return whether a record names a setting, and whether its samples are the stated ones at ``rate``."""
    said = " ".join((*found.notes, *found.warnings)).lower()
    size = found.time.size
    right = abs(found.period * rate - 1.0) < 1e-6 and any(
        np.allclose(found.columns["body_m_s2"], made.BODY[at : at + size], atol=2e-3)
        and np.allclose(found.columns["spool_m_s2"], made.SPOOL[at : at + size], atol=2e-3)
        for at in range(COUNT - size + 1)
    )
    return name.lower() in said, right


@settings(max_examples=DRAWN, deadline=None)
@given(name=st.sampled_from(sorted(FORMATS)), change=st.sampled_from(sorted(CHANGES)), data=st.data())
def test_one_changed_attribute_is_read_right_refused_or_named(
    name: str, change: str, data: st.DataObject
) -> None:
    strategy, of = CHANGES[change]
    usual = Content(
        made.BODY, made.SPOOL, {"fs": RATE}, {"body": {"unit": "m/s^2"}, "spool": {"unit": "m/s^2"}}
    )
    held = of(usual, data.draw(strategy))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        FORMATS[name](path, held)
        how = choices(columns="body=rec/body/data,spool=rec/spool/data") if name == "struct.mat" else None
        try:
            found = read_record(path, how=how)
        except InputError:
            return
    named, right = outcome(found, held.name)
    assert named or (right and change not in ("note", "amount")), (name, change, held, found)
