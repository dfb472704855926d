"""Records and valves: what the analyses take."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from spool_core.errors import InputError

from spool.errors import one_error
from spool.results import Picture, Quality, keeping_backend

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from spool_sim.valve import Valve
    from spool_tools.operations.record_loading import Recording

    Array: TypeAlias = NDArray[np.float64]


class Record:
    """Record of one valve: a bag, or a logger's file that needs no further explanation.

    Attributes:
        path: of the bag or file.
    """

    def __init__(self, path: Path, folder: tempfile.TemporaryDirectory[str] | None = None) -> None:
        self.path = path
        self._folder = folder  # goes with the record

    @cached_property
    def _recording(self) -> Recording:
        from spool_tools.operations.record_loading import load_recording  # noqa: PLC0415 - slow to load, as below

        return load_recording(self.path)

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
        import numpy as np  # noqa: PLC0415

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
    def check(self) -> Quality:
        """Return the quality of the record, as the command ``check`` does.

        Raises:
            InputError: the record cannot be read.
        """
        with keeping_backend():
            from spool_tools.operations.record_loading import Selection  # noqa: PLC0415
            from spool_tools.operations.record_quality import quality_of_record  # noqa: PLC0415

            return Quality(*quality_of_record(self.path, Selection()))

    @one_error
    def plot(self) -> Picture:
        """Return body and spool over time, and their liveliest second.

        Raises:
            InputError: the record cannot be read.
        """
        with keeping_backend():
            from spool_tools.operations.record_quality import quality_of, signals_figure  # noqa: PLC0415

            return Picture(signals_figure(quality_of(self._recording.stretches, str(self.path))))

    @one_error
    def save(self, path: str | Path) -> None:
        """Copy the bag or file to ``path``, which must not exist.

        Raises:
            InputError: it exists, or cannot be written.
        """
        import shutil  # noqa: PLC0415

        target = Path(path)
        if target.exists():
            raise InputError(f"{target}: it is there already: name another one")
        (shutil.copytree if self.path.is_dir() else shutil.copyfile)(self.path, target)

    def _joined(self, name: str) -> Array:
        import numpy as np  # noqa: PLC0415

        return np.concatenate([getattr(one, name) for one in self._recording.stretches])

    def __repr__(self) -> str:
        return f"Record({str(self.path)!r})"


#: What analyses take as a record.
AnyRecord: TypeAlias = Record | str | Path
#: What they take as a valve: a description, a shipped valve's name, or a YAML file.
AnyValve: TypeAlias = "Valve | str | Path"


@one_error
def read(
    path: str | Path | Sequence[str | Path],
    *,
    unit: str | Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, str] | None = None,
    rate: float | None = None,
    dates: str = "",
    empty_as_gap: bool = False,
) -> Record:
    """Return the record in a bag or in any file of a data logger.

    Args:
        path: bag, file, or two files, one of each sensor.
        unit: of both accelerations, or of each (``{"body": "g", "spool": "m/s^2"}``); needed where the file
            does not name it.
        columns: names or numbers of the file's columns by role: ``{"time": "t", "body": "ch1",
            "spool": "#5"}``.
        scale: sensitivities by role: ``{"body": "100mV/g"}``.
        rate: sample rate, Hz, of files without a time.
        dates: order of dates like 05/04/2026: ``dmy`` or ``mdy``; needed where both fit.
        empty_as_gap: leave out rows in which body or spool has no value.

    Raises:
        InputError: no such record, or what it holds is ambiguous; the message names the argument to give.
    """
    paths = [Path(one) for one in ([path] if isinstance(path, (str, Path)) else path)]
    named = (unit, columns, scale, rate, dates or None, empty_as_gap or None)
    if len(paths) == 1 and all(one is None for one in named):
        record = Record(paths[0])
        _ = record._recording  # wrong files are refused here
        return record
    from spool_bag.importing.bag_import import import_record  # noqa: PLC0415 - slow to load
    from spool_bag.importing.choices import choices  # noqa: PLC0415

    units = {"body": unit, "spool": unit} if isinstance(unit, str) else unit or {}
    how = choices(
        columns=_pairs(columns),
        unit=_pairs(units),
        scale=_pairs(scale),
        rate=rate,
        dates=dates,
        empty_as_gap=empty_as_gap,
    )
    folder, bag = _place(paths[0].name.partition(".")[0] or "record")
    import_record(paths, bag, how=how)
    return Record(bag, folder)


@one_error
def valve(name: str | Path | None = None, **data_sheet: str | float) -> Valve:
    """Return a valve description: a shipped one by name, a YAML file, or what a data sheet states.

    Args:
        name: ``4weh10_soft``, ``4weh10_stiff``, or the path of a YAML file.
        data_sheet: numbers with units (without: SI units), named as the options of ``spool valve new``:
            ``spool.valve(id="mine", spool_mass="172g", spring_mass="24g", spring_rate="0.816N/mm")``.

    Raises:
        InputError: no such valve, a name is unknown, or numbers are missing or impossible.
    """
    if (name is None) == (not data_sheet):
        raise InputError("valve: give either a name or file, or the numbers of a data sheet")
    if name is not None:
        from spool_sim.valve import find_valve  # noqa: PLC0415 - slow to load

        return find_valve(str(name))
    from spool_tools.operations.valve_sheet import described  # noqa: PLC0415

    return described({key: str(value) for key, value in data_sheet.items()})[0]


@one_error
def simulate(
    valve: AnyValve = "4weh10_soft",
    model: str | Path = "coulomb",
    excitation: AnyRecord = "sweep",
    seconds: float | None = None,
    *,
    sample_rate: float = 2000.0,
    noise: float = 0.05,
    coulomb_force: float | None = None,
    oil_temperature: str | None = None,
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
        coulomb_force: N; default: the model's.
        oil_temperature: deg C, or ``"20:60"`` for oil that warms; default: the valve's.
        seed: of the noise.

    Raises:
        InputError: no such valve, model or excitation, or a number is out of range.
    """
    from spool_tools.operations.simulation import simulate as write_bag  # noqa: PLC0415 - slow to load

    folder, bag = _place("simulated")
    with valve_files([valve]) as (file,), contextlib.redirect_stdout(io.StringIO()):
        write_bag(
            bag, str(file), str(model), str(path_of(excitation)), seconds,
            sample_rate=sample_rate, block_rate=50.0, coulomb_force=coulomb_force, noise=noise,
            oil_temperature=oil_temperature, seed=seed, name="valve_1",
        )  # fmt: skip
    return Record(bag, folder)


def path_of(record: AnyRecord) -> Path:
    """Return where a record is."""
    return record.path if isinstance(record, Record) else Path(record)


def paths_of(records: AnyRecord | Iterable[AnyRecord]) -> list[Path]:
    """Return where records are, one or several."""
    every = [records] if isinstance(records, (Record, str, Path)) else records
    return [path_of(one) for one in every]


@contextlib.contextmanager
def valve_files(valves: Iterable[AnyValve | None]) -> Iterator[list[str | None]]:
    """Yield the names or files by which the commands find ``valves``; descriptions are written to files."""
    with tempfile.TemporaryDirectory(prefix="spool_") as folder:
        found: list[str | None] = []
        for one in valves:
            if one is None or isinstance(one, (str, Path)):
                found.append(None if one is None else str(one))
                continue
            from spool_tools.operations.valve_sheet import file_text  # noqa: PLC0415 - slow to load

            file = Path(folder) / f"{len(found)}_{one.id}.yaml"
            file.write_text(file_text(one, {}), encoding="utf-8")
            found.append(str(file))
        yield found


def _place(name: str) -> tuple[tempfile.TemporaryDirectory[str], Path]:
    """Return a folder that goes with a record, and the place of its bag."""
    folder = tempfile.TemporaryDirectory(prefix="spool_")
    return folder, Path(folder.name) / name


def _pairs(given: Mapping[str, str] | None) -> list[str] | None:
    return None if not given else [f"{role}={text}" for role, text in given.items()]
