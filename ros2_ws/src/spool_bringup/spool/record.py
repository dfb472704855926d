"""Records and valves: what the analyses take."""

from __future__ import annotations

import contextlib
import io
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray
from spool_bag.importing.bag_import import import_record
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.system import expanded
from spool_report.outputs import replacing
from spool_report.records import simulation
from spool_report.records.record_loading import Recording, load_recording
from spool_report.records.valve_sheet import described, file_text
from spool_report.requests import ImportRequest, Part, Selection, SimulationSettings, TimeSpan
from spool_sim.valve import Valve, find_valve

from spool.errors import one_error
from spool.results import Picture, Quality, keeping_backend

if TYPE_CHECKING:
    import pandas as pd

#: Columns of an array without names, by their number.
_COLUMNS = {2: ("body", "spool"), 3: ("time", "body", "spool")}


class Record:
    """Record of one valve: a bag, or a logger's file that needs no further explanation.

    Attributes:
        path: of the bag or file.
        part: what of it is used, as of ``spool.read``; analyses use the same.
    """

    def __init__(
        self, path: Path, folder: tempfile.TemporaryDirectory[str] | None = None, part: Part | None = None
    ) -> None:
        self.path = path
        self.part = part or part_of(())
        self._folder = folder  # goes with the record

    @cached_property
    @one_error
    def _recording(self) -> Recording:
        return load_recording(self.path, selected(self.part))

    @property
    def sample_rate(self) -> float:
        """Sample rate, Hz."""
        return self._recording.stretches[0].sample_rate

    @property
    def duration(self) -> float:
        """Length of the samples, without gaps, s."""
        return self._recording.duration

    @property
    def valve(self) -> Valve | None:
        """Valve as the bag describes it, ``None`` without a description."""
        return self._recording.described

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was understood: columns, units, conversions."""
        return self._recording.notes

    @property
    def time(self) -> Array:
        """Time of each sample since the first one, s; it jumps at gaps."""

        stretches = self._recording.stretches
        return np.concatenate(
            [
                (one.start - stretches[0].start) * 1e-9 + one.sample_period * np.arange(one.body.size)
                for one in stretches
            ]
        )

    @property
    def body(self) -> Array:
        """Acceleration of the valve body along the spool axis, m/s^2."""
        return self._joined("body")

    @property
    def spool(self) -> Array:
        """Acceleration of the spool, same axis and sign, m/s^2."""
        return self._joined("spool")

    @one_error
    def to_frame(self) -> pd.DataFrame:
        """Return the samples as a pandas table by time in s, with units in the names of the columns.

        ``spool.read`` takes it back.

        Raises:
            InputError: the record cannot be read, or pandas is not installed.
        """
        import pandas as pd  # noqa: PLC0415 - an extra

        columns = {"body_m_s2": self.body, "spool_m_s2": self.spool}
        oil = [one.oil_temperature for one in self._recording.stretches]
        if all(one is not None for one in oil):
            columns["oil_temperature_C"] = np.concatenate([one for one in oil if one is not None])
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time_s"))

    @one_error
    def check(self) -> Quality:
        """Return the quality of the record, as the command ``check`` does.

        Raises:
            InputError: the record cannot be read.
        """
        with keeping_backend():
            from spool_report.runs.record_quality import quality_of_record  # noqa: PLC0415

            return Quality(*quality_of_record(self.path, selected(self.part)))

    @one_error
    def plot(self) -> Picture:
        """Return body and spool over time, and their liveliest second.

        Raises:
            InputError: the record cannot be read.
        """
        with keeping_backend():
            from spool_report.runs.record_quality import quality_of, signals_figure  # noqa: PLC0415

            return Picture(signals_figure(quality_of(self._recording.stretches, str(self.path))))

    @one_error
    def save(self, path: str | Path) -> None:
        """Copy the bag or file to ``path``, which must not exist.

        Raises:
            InputError: it exists, or cannot be written.
        """

        target = Path(path)
        if target.exists():
            raise InputError(f"{target}: already exists: name another file")
        (shutil.copytree if self.path.is_dir() else shutil.copyfile)(self.path, target)

    def _joined(self, name: str) -> Array:

        return np.concatenate([getattr(one, name) for one in self._recording.stretches])

    def _rows(self) -> list[tuple[str, str]]:
        """Return what the record is, as names and texts."""
        recording = self._recording
        oil = recording.stretches[0].oil_temperature is not None
        channels = f"body, spool{', oil temperature' if oil else ''}"
        return [
            ("length", f"{self.duration:.6g} s"),
            ("sample rate", f"{self.sample_rate:.6g} Hz"),
            ("channels", channels),
            ("stretches without gaps", str(len(recording.stretches))),
            ("valve", "not described" if self.valve is None else self.valve.id),
        ]

    def __repr__(self) -> str:
        try:
            rows = self._rows()
        except InputError as error:
            return f"Record({str(self.path)!r}: {error})"
        return f"Record({str(self.path)!r}, {', '.join(f'{name}: {text}' for name, text in rows)})"

    def _repr_html_(self) -> str:

        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in self._rows()
        )
        return f"<table><caption>{escape(str(self.path))}</caption>{rows}</table>"


#: What analyses take as a record.
AnyRecord: TypeAlias = Record | str | Path
#: What they take as a valve: a description, a shipped valve's name, or a YAML file.
AnyValve: TypeAlias = Valve | str | Path


def selected(part: Part) -> Selection:
    """Return what the commands take for ``part``; unlike them, analyses do not take units."""
    return replace(part.selection(), how=None)


@one_error
def read(
    source: str | Path | Sequence[str | Path] | Mapping[str, Any] | Array | pd.DataFrame,
    *,
    unit: str | Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, str] | None = None,
    rate: float | None = None,
    topic: Mapping[str, str] | None = None,
    exclude: str | Sequence[str] = (),
    dates: str = "",
    zone: str = "",
    stamps: str | None = None,
    align: str = "auto",
    empty_as_gap: bool = False,
    name: str | None = None,
    start: float = 0.0,
    stop: float | None = None,
    since: str | None = None,
    until: str | None = None,
    around: str | None = None,
) -> Record:
    """Return the record in a bag, in any file of a data logger, or in arrays.

    Args:
        source: bag, file, or two files, one of each sensor; a pandas table, a mapping of arrays such as
            ``{"time": t, "body": b, "spool": s}``, or an array with the columns time, body and spool, or body
            and spool with ``rate``. A table's index counts as a column if it has a name or holds dates.
        unit: of both accelerations, or of each (``{"body": "g", "spool": "m/s^2"}``); needed where neither
            file nor names state it, as ``body_m_s2`` or ``body [g]`` do.
        columns: names or numbers of the columns by role: ``{"time": "t", "body": "ch1", "spool": "#5"}``.
        scale: sensitivities by role: ``{"body": "100mV/g"}``.
        rate: sample rate, Hz, where there is no time.
        topic: topics and axes of a foreign bag by role: ``{"body": "/imu_1:z", "spool": "/imu_2:z"}``.
        exclude: columns to leave out.
        dates: order of dates like 05/04/2026: ``dmy``, ``mdy`` or ``ymd``; needed where several fit.
        zone: time zone of stamps that name none, e.g. ``Europe/Berlin``; UTC without it.
        stamps: which time of a foreign bag's messages counts: ``header``, ``log`` or ``arrival``.
        align: ``auto``, or ``none`` if two clocks must not be brought together.
        empty_as_gap: leave out rows in which body or spool has no value.
        name: which valve of a bag that holds several.
        start: use the record from here on, s since its first sample.
        stop: use it up to here, s.
        since: of a bag, from then on: ``10m``, ``6h`` or ``7d`` before its end, or a time in UTC such as
            ``2025-01-31T12:00:00``.
        until: end of that span.
        around: of a bag, the minutes around its newest alarm of a kind.

    Raises:
        InputError: no such record, or what it holds is ambiguous; the message names the argument to give.
    """

    part = part_of((), name, start, stop, since, until, around)
    units = {"body": unit, "spool": unit} if isinstance(unit, str) else unit
    request = ImportRequest(
        columns=_pairs("columns", columns), unit=_pairs("unit", units), scale=_pairs("scale", scale),
        topic=_pairs("topic", topic), rate=rate, align=align, exclude=exclude or (), stamps=stamps,
        dates=dates, empty_as_gap=empty_as_gap, zone=zone,
    )  # fmt: skip
    if not isinstance(source, (str, Path, list, tuple)):
        return _read_arrays(source, part, replace(request, align="none"))
    paths = [_file(one) for one in ([source] if isinstance(source, (str, Path)) else source)]
    if len(paths) > 1 or request != ImportRequest():
        return _imported(paths, part, request)
    record = Record(paths[0], None, part)
    _ = record._recording  # wrong files are refused here
    return record


def _imported(paths: Sequence[Path], part: Part, request: ImportRequest) -> Record:
    """Return the record in files that are read as ``request`` asks."""

    folder, bag = _place(paths[0].name.partition(".")[0] or "record")
    import_record(paths, bag, how=request.choices())
    record = Record(bag, folder, part)
    if part != part_of(()):
        _ = record._recording
    return record


@one_error
def valve(
    name: str | Path | None = None,
    *,
    id: str | None = None,  # noqa: A002 - the key of valve files
    moving_mass: str | float | None = None,
    spool_mass: str | float | None = None,
    spring_mass: str | float | None = None,
    oil_mass: str | float | None = None,
    spring_stiffness: str | float | None = None,
    spring_rate: str | float | None = None,
    natural_frequency: str | float | None = None,
    land_diameter: str | float | None = None,
    land_length: str | float | None = None,
    radial_clearance: str | float | None = None,
    oil: str | None = None,
    oil_temperature: str | float | None = None,
    dynamic_viscosity: str | float | None = None,
) -> Valve:
    """Return a valve description: a shipped one by name, a YAML file, or what a data sheet states.

    Numbers are text with a unit, or in SI units; temperatures are in deg C.

        spool.valve(id="mine", spool_mass="172g", spring_mass="24g", spring_rate="0.816N/mm")

    Args:
        name: ``4weh10_soft``, ``4weh10_stiff``, or the path of a YAML file.
        id: name of the valve that a data sheet describes.
        moving_mass: kg; spool, oil in it and 1/3 of the springs, or the next two.
        spool_mass: kg; of the spool alone.
        spring_mass: kg; of both centring springs together.
        oil_mass: kg; of the oil that moves with the spool.
        spring_stiffness: N/m; of both centring springs together, or one of the next two.
        spring_rate: N/m; of one of two equal centring springs.
        natural_frequency: Hz; of the spool on its springs.
        land_diameter: m.
        land_length: m; of all sealing lands together.
        radial_clearance: m; between spool and bore.
        oil: HL68, Azolla ZS22, or ISO VG 10 to ISO VG 100; needs ``oil_temperature``.
        oil_temperature: deg C; of the oil at work.
        dynamic_viscosity: Pa s; at that temperature.

    Raises:
        InputError: no such valve, or numbers are missing or impossible.
    """
    given = locals().copy()
    data_sheet = {key: str(value) for key, value in given.items() if key != "name" and value is not None}
    if (name is None) == (not data_sheet):
        raise InputError("spool.valve: give either a name or file, or the numbers of a data sheet")
    if name is not None:
        return find_valve(str(name))
    if oil is not None and oil_temperature is None:
        raise InputError("spool.valve: oil needs the temperature at work: add oil_temperature=45 (deg C)")

    return described(data_sheet)[0]


@one_error
def simulate(
    valve: AnyValve = "4weh10_soft",
    model: str | Path = "coulomb",
    excitation: AnyRecord = "sweep",
    seconds: float | None = None,
    *,
    sample_rate: float = 2000.0,
    noise: float = 0.05,
    filter: str = "instants",  # noqa: A002 - as the option and the key of sensors are called
    coulomb_force: float | None = None,
    oil_temperature: str | float | None = None,
    seed: int = 0,
) -> Record:
    """Return a simulated record of a valve.

    Args:
        valve: description, name or file.
        model: name or YAML file.
        excitation: preset (``sweep``, ``multisine``, ...), YAML file, or a record whose body acceleration
            shakes the valve.
        seconds: length; default: that of a record, else 40 s.
        sample_rate: Hz.
        noise: of both sensors, rms, m/s^2.
        filter: low-pass of both channels before sampling: ``instants``, ``mean``, ``linear``, ``causal``,
            or like ``linear,6,0.42`` with order and corner over the sample rate.
        coulomb_force: N; default: the model's.
        oil_temperature: deg C, or ``"20:60"`` (deg C) for oil that warms; default: the valve's.
        seed: of the noise.

    Raises:
        InputError: no such valve, model or excitation, or a number is out of range.
    """

    folder, bag = _place("simulated")
    oil = None if oil_temperature is None else str(oil_temperature)
    with valve_files([valve]) as (file,), contextlib.redirect_stdout(io.StringIO()):
        settings = SimulationSettings(
            str(file), str(model), str(path_of(excitation)), seconds, sample_rate,
            coulomb_force=coulomb_force, noise=noise, filter=filter, seed=seed, oil_temperature=oil,
        )  # fmt: skip
        simulation.simulate(bag, settings)
    return Record(bag, folder)


@one_error
def export_fmu(
    valve: AnyValve, path: str | Path, *, model: str | Path = "coulomb", fmi: int = 3, replace: bool = False
) -> Path:
    """Write a valve with its model as an FMU (Co-Simulation), for Simulink, Modelica tools and others.

    Args:
        valve: description, name or file.
        path: FILE.fmu.
        model: name or YAML file, as ``save_model`` writes it; its 95 % intervals come along.
        fmi: version of the standard, 2 or 3.
        replace: replace an existing file.

    Raises:
        InputError: no such valve or model, the file exists or cannot be written, or no C compiler works here.
    """
    from spool_design.fmu import export_fmu as write_fmu  # noqa: PLC0415 - an add-on

    with replacing(replace), valve_files([valve]) as (file,):
        write_fmu(str(file), Path(path), str(model), fmi)
    return Path(path)


def path_of(record: AnyRecord) -> Path:
    """Return where a record is.

    Raises:
        InputError: it is no record.
    """
    if isinstance(record, Record):
        return record.path
    if hasattr(record, "moving_mass"):
        raise InputError("a valve was given in place of a record: records come first, then the valve")
    if not isinstance(record, (str, Path)):
        raise InputError(f"{type(record).__name__}: not a record: pass the result of spool.read, or a path")
    return expanded(record)


def listed(records: AnyRecord | Iterable[AnyRecord]) -> list[AnyRecord]:
    """Return one record or several as a list.

    Raises:
        InputError: there is none.
    """
    if isinstance(records, (Record, str, Path)) or not isinstance(records, Iterable):
        return [records]
    if hasattr(records, "moving_mass"):  # a valve, whose keys can be iterated over
        path_of(cast("AnyRecord", records))
    every = list(records)
    if not every:
        raise InputError("no record given: pass the result of spool.read, or a path")
    return every


def part_of(
    records: Sequence[AnyRecord], name: str | None = None, start: float = 0.0, stop: float | None = None,
    *when: str | None,
) -> Part:  # fmt: skip
    """Return which part of ``records`` an analysis uses: the given one, else that of the records.

    ``when``: since, until, around.

    Raises:
        InputError: records were read in different parts.
    """
    given = Part(name=name, start=float(start), stop=stop, when=TimeSpan(*when))
    found = {each.part for each in records if isinstance(each, Record)}
    if given == Part() and len(found) > 1:
        raise InputError("the records were read in different parts (name, start, since ...): read them alike")
    return found.pop() if found and given == Part() else given


@contextlib.contextmanager
def valve_files(valves: Iterable[AnyValve | None]) -> Iterator[list[str | None]]:
    """Yield the names or files by which the commands find ``valves``; descriptions are written to files.

    Raises:
        InputError: one is no valve.
    """
    with tempfile.TemporaryDirectory(prefix="spool_") as folder:
        found: list[str | None] = []
        for one in valves:
            if one is None or isinstance(one, (str, Path)):
                found.append(None if one is None else str(one))
                continue
            if not hasattr(one, "moving_mass"):
                raise InputError(
                    f"valve: {type(one).__name__} is no valve: pass what spool.valve returns, a name or a "
                    "file; records come before the valve"
                )

            file = Path(folder) / f"{len(found)}_{one.id}.yaml"
            file.write_text(file_text(one, {}), encoding="utf-8")
            found.append(str(file))
        yield found


def _file(one: object) -> Path:
    if not isinstance(one, (str, Path)):
        raise InputError(
            f"spool.read: {type(one).__name__} in a list is no path: give one table, array or mapping"
        )
    return expanded(one)


def _read_arrays(source: Any, part: Part, request: ImportRequest) -> Record:
    """Return the record in arrays: a file of them is imported like any other.

    Raises:
        InputError: they are no record, or what they hold is ambiguous.
    """
    folder, file = _place("arrays.parquet")
    with folder:
        _write_arrays(source, request.rate, file)
        try:
            return _imported([file], part, request)
        except InputError as error:
            raise InputError(str(error).replace(str(file), "arrays")) from error


def _place(name: str) -> tuple[tempfile.TemporaryDirectory[str], Path]:
    """Return a folder that goes with a record, and the place of its bag."""
    folder = tempfile.TemporaryDirectory(prefix="spool_")
    return folder, Path(folder.name) / name


def _pairs(argument: str, given: Mapping[str, str] | None) -> tuple[str, ...]:
    if given is not None and not isinstance(given, Mapping):
        raise InputError(
            f'spool.read: {argument}={given!r:.60} is no mapping: write {argument}={{"body": ...}}'
        )
    return tuple(f"{role}={text}" for role, text in (given or {}).items())


def _write_arrays(source: Any, rate: float | None, file: Path) -> None:
    """Write a mapping of arrays, an array, a pandas, Polars or Arrow table as a Parquet file."""
    import pyarrow.parquet  # noqa: PLC0415 - slow to load

    try:
        if isinstance(source, pyarrow.Table):
            table = source
        elif hasattr(source, "columns") and hasattr(source, "index"):  # pandas
            kept = source.index.name is not None or str(source.index.dtype).startswith("datetime64")
            table = pyarrow.Table.from_pandas(source, preserve_index=kept)
            names = ["time" if one == "__index_level_0__" else one for one in table.column_names]
            table = table.rename_columns(names)
        elif hasattr(source, "to_arrow"):  # polars
            table = source.to_arrow()
        else:
            table = pyarrow.table({key: pyarrow.array(row) for key, row in _rows(source, rate).items()})
        pyarrow.parquet.write_table(table, file)
    except (pyarrow.ArrowException, TypeError) as error:
        raise InputError(f"arrays: {' '.join(str(error).split())}: give numbers and times") from error


def _rows(source: Any, rate: float | None) -> dict[str, NDArray[Any]]:
    """Return the columns of a mapping of arrays or an array by name, each of one value a sample."""
    if isinstance(source, Mapping):
        named = {str(key): np.asarray(value) for key, value in source.items()}
    elif isinstance(source, np.ndarray):
        named = _named(source, rate)
    else:
        raise InputError(
            f"spool.read: {type(source).__name__} is no record: give a path, a pandas table, a mapping of "
            "arrays or an array"
        )
    flat = {key: row.ravel() if row.ndim == 2 and 1 in row.shape else row for key, row in named.items()}
    odd = next((key for key, row in flat.items() if row.ndim != 1), None)
    if odd is not None:
        raise InputError(f"arrays: {odd} has the shape {flat[odd].shape}: give one value for each sample")
    sizes = {key: row.size for key, row in flat.items()}
    if len(set(sizes.values())) > 1:
        said = ", ".join(f"{key} has {size}" for key, size in sizes.items())
        raise InputError(f"arrays: lengths differ: {said} values: give arrays of one length")
    return flat


def _named(array: Any, rate: float | None) -> dict[str, Any]:
    """Return the columns of an array by name."""
    if array.dtype.names:
        return {name: array[name] for name in array.dtype.names}
    wanted = "give columns time, body and spool, or body and spool with rate=, or a mapping with names"
    if array.ndim != 2 or array.shape[1] not in _COLUMNS:
        turned = array.ndim == 2 and array.shape[0] in _COLUMNS
        hint = "; its rows are channels: pass array.T" if turned else ""
        raise InputError(f"spool.read: an array of the shape {array.shape}: {wanted}{hint}")
    if array.shape[1] == 2 and rate is None:
        raise InputError(f"spool.read: an array of two columns has no time: {wanted}")
    return {name: array[:, at] for at, name in enumerate(_COLUMNS[array.shape[1]])}
