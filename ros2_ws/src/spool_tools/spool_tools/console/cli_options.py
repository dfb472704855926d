"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from .completion import excitation_names, model_names, valve_names
from .outputs import STANDARD_OUTPUT, check_output, replace_existing, text_to_stderr


def _json_target(path: Path | None) -> Path | None:
    """Check where JSON goes; ``-`` keeps standard output for it."""
    if path == STANDARD_OUTPUT:
        text_to_stderr()
        return path
    return check_output(path, "--json")


def _target(option: str) -> Callable[[Path | None], Path | None]:
    """Return the callback that checks the file of ``option`` before any work is done."""
    return lambda path: check_output(path, option)


JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json", help="Write the result as JSON, SI units; - for standard output.", callback=_json_target
    ),
]
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
ValveFile = Annotated[
    str,
    typer.Option(
        "--valve", help="YAML file of the valve, or a shipped one's name.", autocompletion=valve_names
    ),
]
ModelName = Annotated[
    str, typer.Option("--model", help="Model: its name or a YAML file.", autocompletion=model_names)
]
ExcitationName = Annotated[
    str,
    typer.Option(
        "--excitation",
        help="Body acceleration: a preset, a YAML file, or a record (bag or CSV file).",
        autocompletion=excitation_names,
    ),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", help="Names in a CSV file, e.g. time_s=t,body_m_s2=ch1,spool_m_s2=ch2"),
]
BagArgument = Annotated[Path, typer.Argument(help="rosbag2 directory or .mcap file.", metavar="BAG")]
RecordArgument = Annotated[
    Path, typer.Argument(help="rosbag2 directory, .mcap or CSV file.", metavar="RECORD")
]
