"""`./spool paper`: the paper's series, figures and tables on made data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_report.outputs import check_folder
from spool_tools.command import Command, Force


def paper(
    out: Annotated[Path, typer.Option(help="Folder for page, pictures and tables.")] = Path("spool_paper"),
    _force: Force = False,
) -> None:
    """Run the paper's four series and four models; write figures and tables with the printed numbers.

    The authors' measurements are not published: the data are simulated with stated parameters.

    Example: ./spool paper --out my_paper
    """
    from spool_evaluation.paper.page import run_paper  # noqa: PLC0415 - slow to load

    run_paper(check_folder(out))


COMMAND = Command(paper, place=530, line="the paper's series, figures and tables, on made data")
