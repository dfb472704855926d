"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON, SI units.")]
ValveFile = Annotated[str, typer.Option("--valve", help="YAML file of the valve, or a shipped one's name.")]
BagArgument = Annotated[Path, typer.Argument(help="rosbag2 directory or .mcap file.", metavar="BAG")]
