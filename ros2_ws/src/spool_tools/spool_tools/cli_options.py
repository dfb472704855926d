"""Options and arguments that several commands share, and the completion of their values."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from spool_tools.outputs import STANDARD_OUTPUT, check_output, replace_existing, text_to_stderr


def _json_target(path: Path | None) -> Path | None:
    """Check where JSON goes; ``-`` keeps standard output for it."""
    if path == STANDARD_OUTPUT:
        text_to_stderr()
        return path
    return check_output(path, "--json")


JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json", help="Write the result as JSON, SI units; - for standard output.", callback=_json_target
    ),
]


def _target(option: str) -> Callable[[Path | None], Path | None]:
    """Return the callback that checks the file of ``option`` before any work is done."""
    return lambda path: check_output(path, option)


ReportFile = Annotated[
    Path | None,
    typer.Option(
        "--report",
        help="Write pictures and tables as one HTML page.",
        metavar="HTML",
        callback=_target("--report"),
    ),
]
ModelFile = Annotated[
    Path | None,
    typer.Option(
        "--save-model",
        help="Write the model found as YAML, for simulate and the nodes.",
        metavar="YAML",
        callback=_target("--save-model"),
    ),
]
Force = Annotated[
    bool,
    typer.Option(
        "--force", help="Replace files that are there already.", is_eager=True, callback=replace_existing
    ),
]


def valve_names(incomplete: str) -> list[str]:
    """Return the shipped valves that begin so."""
    from spool_sim.valve import shipped_valves  # noqa: PLC0415 - slow to load, as below

    return [name for name in shipped_valves() if name.startswith(incomplete)]


ValveFile = Annotated[
    str,
    typer.Option(
        "--valve", help="YAML file of the valve, or a shipped one's name.", autocompletion=valve_names
    ),
]
ParamsFile = Annotated[
    Path | None,
    typer.Option(
        "--params-file",
        help="Parameter file of the nodes, with the limits of the plant; default: the shipped limits.",
        metavar="YAML",
    ),
]


def model_names(incomplete: str) -> list[str]:
    """Return the models that begin so."""
    from spool_sim.model import MODELS  # noqa: PLC0415

    return [name for name in MODELS if name.startswith(incomplete)]


ModelName = Annotated[
    str, typer.Option("--model", help="Model: its name or a YAML file.", autocompletion=model_names)
]


def excitation_names(incomplete: str) -> list[str]:
    """Return the excitations that begin so."""
    from spool_sim.excitation import PRESETS  # noqa: PLC0415

    return [name for name in PRESETS if name.startswith(incomplete)]


ExcitationName = Annotated[
    str,
    typer.Option(
        "--excitation",
        help="Body acceleration: a preset, a YAML file, or a record (bag or file).",
        autocompletion=excitation_names,
    ),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", help="Names in a file, e.g. time_s=t,body_m_s2=ch1,spool_m_s2=ch2"),
]
BagArgument = Annotated[Path, typer.Argument(help="rosbag2 directory or .mcap file.", metavar="BAG")]
RecordArgument = Annotated[
    Path, typer.Argument(help="rosbag2 directory, .mcap, or a logger's file.", metavar="RECORD")
]
NewBag = Annotated[Path, typer.Option("--out", help="Bag to be made.", metavar="BAG")]
RecordsArgument = Annotated[
    list[Path], typer.Argument(help="Bags or loggers' files of one valve.", metavar="RECORD...")
]
OutFolder = Annotated[
    Path | None, typer.Option("--out", help="Folder for all of these files.", metavar="DIR")
]
FittedValve = Annotated[
    str | None,
    typer.Option(
        "--valve", help="YAML file of the valve, or a shipped one's name; default: the bag's own.",
        autocompletion=valve_names,
    ),
]  # fmt: skip
LanguageOption = Annotated[
    str,
    typer.Option(
        "--language", help="Language of alarms: en, de or pl; default: that of SPOOL_LANGUAGE, else English."
    ),
]
NameOption = Annotated[
    str | None, typer.Option("--name", help="Which valve of a bag that holds several, e.g. valve_2.")
]
StartOption = Annotated[float, typer.Option(help="Use the record from here on, s since its first sample.")]
StopOption = Annotated[float | None, typer.Option(help="Use the record up to here, s; default: its end.")]
SinceOption = Annotated[
    str | None,
    typer.Option(
        "--since", help="Of a bag, from then on: 10m, 6h or 7d before its end, or 2025-01-31T12:00:00 (UTC)."
    ),
]
UntilOption = Annotated[
    str | None, typer.Option("--until", help="End of the time span (same formats as --since; bags only).")
]
AroundOption = Annotated[
    str | None,
    typer.Option(
        "--around",
        help="Of a bag, a minute before and after its newest alarm of a kind, e.g. resonance; "
        "resonance:2 for the one before; alarm for any.",
    ),
]
HoldoutOption = Annotated[
    list[Path] | None,
    typer.Option(
        help="Record to judge the error by; default: a quarter of each record is held out.", metavar="RECORD"
    ),
]
SensorGain = Annotated[
    bool, typer.Option("--sensor-gain", help="Fit the gain error of the spool's sensor as well.")
]
SensorDelay = Annotated[
    bool, typer.Option("--sensor-delay", help="Fit the delay of the spool's sensor as well.")
]


def in_range(low: float, high: float = math.inf) -> Callable[[float | None], float | None]:
    """Return the callback that refuses what is not a finite number from ``low`` to ``high``."""

    def checked(value: float | None) -> float | None:
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            most = f"{low:g} to {high:g}" if high < math.inf else f"at least {low:g}"
            raise typer.BadParameter(f"{value:g} is out of range: use {most}.")
        return value

    return checked
