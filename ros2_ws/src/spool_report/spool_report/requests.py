"""Requests of analyses; their fields are also the options of the commands, with help."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from spool_core.errors import InputError

if TYPE_CHECKING:
    from spool_bag.importing.choices import Choices

#: Panels of options: the part of a record to use, and what few need.
PART, EXPERT = "Part of the record", "Expert"


def valve_names(incomplete: str) -> list[str]:
    """Return the shipped valves that begin so."""
    from spool_sim.valve import shipped_valves  # noqa: PLC0415 - slow to load, as below

    return [name for name in shipped_valves() if name.startswith(incomplete)]


def model_names(incomplete: str) -> list[str]:
    """Return the models that begin so."""
    from spool_sim.model import MODELS  # noqa: PLC0415

    return [name for name in MODELS if name.startswith(incomplete)]


def excitation_names(incomplete: str) -> list[str]:
    """Return the excitations that begin so."""
    from spool_sim.excitation import PRESETS  # noqa: PLC0415

    return [name for name in PRESETS if name.startswith(incomplete)]


def in_range(low: float, high: float = math.inf) -> Callable[[float | None], float | None]:
    """Return the callback that refuses what is not a finite number from ``low`` to ``high``."""

    def checked(value: float | None) -> float | None:
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            most = f"{low:g} to {high:g}" if high < math.inf else f"at least {low:g}"
            raise typer.BadParameter(f"{value:g} is out of range: use {most}.")
        return value

    return checked


def option(text: str, *names: str, panel: str | None = None, **how: Any) -> Any:
    """Return an option with the help ``text``, in a panel of the help; ``how`` as typer takes it."""
    return typer.Option(*names, rich_help_panel=panel, help=text, **how)


def _part(text: str) -> Any:
    return option(text, panel=PART)


RecordArgument = Annotated[
    Path, typer.Argument(help="rosbag2 directory, .mcap, or a logger's file.", metavar="RECORD")
]
ValveFiles = Annotated[
    Sequence[str],
    option(
        "YAML file of the valve, or name of a shipped valve; NAME=FILE for each of several valves. "
        "Default: description in the bag.",
        autocompletion=valve_names,
    ),
]
ParamsFile = Annotated[
    Path | None,
    option(
        "Parameter file of the nodes, with the limits of the plant; default: the shipped limits.",
        metavar="YAML",
    ),
]
LanguageOption = Annotated[
    str, option("Language of alarms: en, de or pl; default: SPOOL_LANGUAGE, else English.")
]
ColumnsOption = Annotated[
    str | None, _part("Column names in the file, e.g. time_s=t,body_m_s2=ch1,spool_m_s2=ch2")
]
ExcludeOption = Annotated[Sequence[str], _part("Columns to ignore, by name or number: NAME,#3")]
UnitOption = Annotated[Sequence[str], _part("Units missing in the file: body=g,force=N,time=ms")]
ScaleOption = Annotated[
    Sequence[str], _part("Sensitivities: body=100mV/g,spool=50g/FS; raw counts: body=1.25e-6g/count")
]
RateOption = Annotated[
    float | None, _part("Sample rate in Hz, for files with a missing or poor time column.")
]
ShippedValve = Annotated[
    str, option("YAML file of the valve, or name of a shipped valve.", autocompletion=valve_names)
]
ExcitationName = Annotated[
    str,
    option(
        "Body acceleration: a preset, a YAML file, or a record (bag or file).",
        autocompletion=excitation_names,
    ),
]
ModelName = Annotated[str, option("Model: its name or a YAML file.", "--model", autocompletion=model_names)]
_RECORDS = typer.Argument(help="Bags or logger files of one valve.", metavar="RECORD...")
_Valve = Annotated[
    str | None,
    option(
        "YAML file of the valve, or name of a shipped valve; default: valve in the bag.",
        autocompletion=valve_names,
    ),
]
_Holdout = Annotated[
    Sequence[Path],
    option(
        "Held-out record for validation; default: a quarter of each record is held out.", metavar="RECORD"
    ),
]
_SensorGain = Annotated[
    bool, option("Fit the gain error of the spool's sensor as well.", "--sensor-gain", panel=EXPERT)
]
_SensorDelay = Annotated[
    bool, option("Fit the delay of the spool's sensor as well.", "--sensor-delay", panel=EXPERT)
]


@dataclass(frozen=True, slots=True)
class TimeSpan:
    """Time span of a bag, as the options name it."""

    since: Annotated[
        str | None,
        _part(
            "Start of the time span: 10m, 6h or 7d before the end, or 2025-01-31T12:00:00 (UTC); bags only."
        ),
    ] = None
    until: Annotated[str | None, _part("End of the time span (same formats as --since; bags only).")] = None
    around: Annotated[
        str | None,
        _part(
            "Use one minute before and after the newest alarm of this kind, e.g. resonance. "
            "resonance:2: second newest; alarm: any kind (bags only)."
        ),
    ] = None


#: A whole record.
EVER = TimeSpan()


@dataclass(frozen=True, slots=True)
class Selection:
    """Selection of what to take of each record.

    Attributes:
        name: namespace of the valve, needed where a bag holds several.
        columns: a file's own names by contract name, ``None`` where they are the contract's.
        start, stop: s since the record's first sample; all of it by default.
        longest: samples of a bag that are held at most, parts of a longer one; ``None``: all.
        described: look for the valve's description in a bag.
        when: span of a bag.
        how: units, sensitivities, rate and left out columns of a file, ``None`` where nobody can say that.
    """

    name: str | None = None
    columns: Mapping[str, str] | None = None
    start: float = 0.0
    stop: float = math.inf
    longest: int | None = None
    described: bool = True
    when: TimeSpan = EVER
    how: Choices | None = None

    def __post_init__(self) -> None:
        """Raises InputError where no time is left between ``start`` and ``stop``."""
        if not 0.0 <= self.start < self.stop:
            raise InputError(
                f"--start {self.start:g} s, --stop {self.stop:g} s: use 0 <= start < stop, "
                "counted from the record's first sample"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Part of a record and how it is read."""

    name: Annotated[str | None, _part("Valve to use if the bag holds several, e.g. valve_2.")] = None
    columns: ColumnsOption = None
    unit: UnitOption = ()
    scale: ScaleOption = ()
    rate: RateOption = None
    exclude: ExcludeOption = ()
    start: Annotated[float, _part("Start of the part to use, in s from the first sample.")] = 0.0
    stop: Annotated[float | None, _part("End of the part to use, in s; default: record end.")] = None
    when: TimeSpan = EVER

    def selection(self) -> Selection:
        """Return what the readers of records take."""
        from spool_bag.importing.choices import choices, columns_of  # noqa: PLC0415 - slow to load

        how = choices(unit=self.unit, scale=self.scale, rate=self.rate, exclude=self.exclude)
        stop = math.inf if self.stop is None else self.stop
        return Selection(self.name, columns_of(self.columns), self.start, stop, when=self.when, how=how)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayRequest:
    """Request to run estimator and monitor over a record."""

    record: RecordArgument
    valve: ValveFiles = ()
    columns: ColumnsOption = None
    state: Annotated[
        Path | None,
        option("Folder that keeps each valve's baseline: learned from the first record.", metavar="DIR"),
    ] = None
    when: TimeSpan = EVER
    params_file: ParamsFile = None
    language: LanguageOption = ""
    refits: Annotated[bool, option("Refit the last 4 s at regular intervals.", "--refits")] = False
    refit_model: Annotated[
        str, option("Model of the refits: name or YAML file.", autocompletion=model_names)
    ] = "coulomb"
    refit_period: Annotated[float, option("Data time between refits, s.", callback=in_range(0.1, 3600.0))] = (
        5.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayRequest:
    """Request to play a record to live nodes."""

    record: RecordArgument
    valve: ValveFiles = ()
    speed: Annotated[float, option("Seconds of the record in a second.", callback=in_range(1.0, 20.0))] = 1.0
    no_web: Annotated[bool, option("Serve no page; end with the record.", "--no-web")] = False
    port: Annotated[int, option("Port of the page; 0: any free one.", min=0, max=65535)] = 8765
    columns: ColumnsOption = None
    state: Annotated[
        Path | None, option("Folder that keeps baselines and alarms from record to record.", metavar="DIR")
    ] = None
    when: TimeSpan = EVER
    params_file: ParamsFile = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportRequest:
    """Request to read files of data loggers in a certain way."""

    columns: Annotated[
        Sequence[str], option("Columns by name or by number from 0, e.g. time=t,body=ch1,spool=#5")
    ] = ()
    exclude: ExcludeOption = ()
    unit: UnitOption = ()
    scale: ScaleOption = ()
    rate: RateOption = None
    dates: Annotated[str, option("Order of dates like 05/04/2026 or 26/05/04: dmy, mdy or ymd.")] = ""
    zone: Annotated[str, option("Time zone of stamps that name none: Europe/Berlin; default: UTC.")] = ""
    empty_as_gap: Annotated[
        bool, option("Leave out rows in which body or spool has no value.", "--empty-as-gap")
    ] = False
    pulses: Annotated[
        int | None,
        option("Pulses of the column tacho_pulse, or of --columns tacho=ch3.", "--pulses-per-revolution"),
    ] = None
    topic: Annotated[Sequence[str], option("Topics and axes of a bag: body=/imu_1:z,spool=/imu_2:z")] = ()
    stamps: Annotated[
        str | None, option("Time of a bag's messages: header (default), log or arrival (time of reception).")
    ] = None
    align: Annotated[
        str, option("auto: bring two clocks together by correlation; none: refuse two clocks.")
    ] = "auto"

    def choices(self) -> Choices:
        """Return them as the readers of files take them; raises InputError where one is misspelt."""
        from spool_bag.importing.choices import choices  # noqa: PLC0415 - slow to load

        return choices(**asdict(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class FitRequest:
    """Request to fit one model to records."""

    records: Annotated[Sequence[Path], _RECORDS] = ()
    valve: _Valve = None
    model: ModelName = "coulomb"
    free: Annotated[
        Sequence[str],
        option("Parameter to fit although the valve file states it; =VALUE is its start value."),
    ] = ()
    fix: Annotated[
        Sequence[str], option("Parameter to hold, at VALUE (PARAMETER=VALUE) or at the valve file's value.")
    ] = ()
    holdout: _Holdout = ()
    force_free: Annotated[
        bool,
        option("Do not hold parameters that the records do not determine.", "--force-free", panel=EXPERT),
    ] = False
    sensor_gain: _SensorGain = False
    sensor_delay: _SensorDelay = False


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareRequest:
    """Request to fit several models to records and to rank them."""

    records: Annotated[Sequence[Path], _RECORDS]
    valve: Annotated[
        Sequence[str],
        option("Valve file, as for fit; one for all records, or one per record.", autocompletion=valve_names),
    ] = ()
    models: Annotated[
        Sequence[str],
        option(
            "Names or YAML files, separated by commas; default: the paper's models, coulomb, stribeck.",
            callback=lambda given: [name for text in given for name in text.split(",")],
        ),
    ] = ()
    together: Annotated[bool, option("Treat all records as one set of data.", "--together")] = False
    holdout: _Holdout = ()
    sensor_gain: _SensorGain = False
    sensor_delay: _SensorDelay = False


@dataclass(frozen=True, slots=True, kw_only=True)
class GapRequest:
    """Request to find what a model lacks in records."""

    records: Annotated[Sequence[Path], _RECORDS]
    valve: _Valve = None
    base: Annotated[
        str, option("Base model that the command extends: name or YAML file.", autocompletion=model_names)
    ] = "fluid"
    holdout: Annotated[
        Sequence[Path],
        option("Held-out record for validation; default: every other section is held out.", metavar="RECORD"),
    ] = ()
    kind: Annotated[
        Literal["accelerations", "driven", "imposed"],
        option("accelerations, driven (a force moves the mass) or imposed (the force is the reaction)."),
    ] = "accelerations"
    mass: Annotated[
        float | None, option("Moving mass of a driven record, kg; default: mass of the valve, else fitted.")
    ] = None
    gain_tolerance: Annotated[
        float, option("Relative gain tolerance of the spool's sensor, from its data sheet.", panel=EXPERT)
    ] = 0.05
    delay_tolerance: Annotated[float, option("Permitted delay between the channels, s.", panel=EXPERT)] = (
        0.5e-3
    )
    least_share: Annotated[
        float, option("Smallest effect to name, as a share of the spool's rms acceleration.", panel=EXPERT)
    ] = 0.0025
    thorough: Annotated[
        bool, option("Complete the search; default: stop after about a minute.", panel=EXPERT)
    ] = False
    profiles: Annotated[
        bool,
        option(
            "Report for each named parameter whether the record determines it.", "--profiles", panel=EXPERT
        ),
    ] = False

    def __post_init__(self) -> None:
        """Raises InputError where a number is out of range."""
        for option, value, most in (
            ("--gain-tolerance", self.gain_tolerance, 0.4),
            ("--delay-tolerance", self.delay_tolerance, 4e-3),
            ("--least-share", self.least_share, 0.5),
        ):
            if not 0.0 <= value <= most:
                raise InputError(f"{option} {value:g}: out of range: use 0 to {most:g}")
        if self.mass is not None and not (self.kind == "driven" and 0.0 < self.mass < math.inf):
            raise InputError(f"--mass {self.mass:g}: a mass > 0 kg, with --kind 'driven'")


@dataclass(frozen=True, slots=True)
class SimulationSettings:
    """Record to simulate."""

    valve: ShippedValve = "4weh10_soft"
    model: ModelName = "coulomb"
    excitation: ExcitationName = "sweep"
    seconds: Annotated[float | None, option("Length, s; default: the recorded excitation's, else 40.")] = None
    sample_rate: Annotated[float, option("Hz")] = 2000.0
    block_rate: Annotated[float, option("Blocks a second.")] = 50.0
    coulomb_force: Annotated[float | None, option("N; default: the model's.")] = None
    noise: Annotated[float, option("Sensor noise, rms, m/s^2.")] = 0.05
    filter: Annotated[
        str,
        option(
            "Low-pass of both channels: instants, mean, linear, causal, or like linear,6,0.42 with "
            "order and corner over the sample rate, causal also a shape."
        ),
    ] = "instants"
    sensors: Annotated[Path | None, option("YAML file of the sensors, replaces --noise and --filter.")] = None
    oil_temperature: Annotated[
        str | None,
        option("deg C, or 20:60 for oil that warms; default: the valve file's. Sets the viscosity."),
    ] = None
    seed: Annotated[int, option("Seed of the noise.", min=0)] = 0
    name: Annotated[str, option("Namespace of the valve in the bag.")] = "valve_1"

    def __post_init__(self) -> None:
        """Raises InputError where the noise is out of range."""
        if not 0.0 <= self.noise < math.inf:
            raise InputError(f"--noise {self.noise:g}: out of range: use at least 0")
