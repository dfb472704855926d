"""What a node or a refusal loads: a library that it does not need costs every start its time and memory."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

#: Libraries, and parts of SciPy, that take a tenth of a second or more to load.
ANALYSIS = ("scipy.fft", "scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats")
PICTURES = ("jinja2", "matplotlib")
TABLES = ("duckdb", "openpyxl", "pandas", "pint", "pyarrow")
COMMANDS = ("rich", "typer")
NODE = (*ANALYSIS, *PICTURES, *TABLES, *COMMANDS)
REFUSAL = (*ANALYSIS, *PICTURES, *TABLES, "numba", "numpy", "rclpy", "yaml")

RUN = "from spool_tools.cli import main; main({})"


@pytest.mark.parametrize(
    ("code", "spared"),
    [
        ("import spool_monitor.monitor_node", (*NODE, "spool_sim")),
        ("import spool_estimator.estimator_node", (*NODE, "spool_sim.simulator")),
        ("import spool_sim.simulator_node", NODE),
        ("import spool_bag.recorder_node", NODE),
        (RUN.format(["--version"]), (*REFUSAL, "pydantic", "rich")),
        (RUN.format(["dance"]), REFUSAL),
        (RUN.format(["info", "missing"]), REFUSAL),
        (RUN.format(["replay", "missing.csv"]), REFUSAL),
        (RUN.format(["gap", "missing"]), REFUSAL),
        (RUN.format(["export", "missing", "--out", "table.csv"]), REFUSAL),
        (RUN.format(["simulate", "--excitation", "dance", "--out", "bag"]), (*ANALYSIS, "numba", "rclpy")),
    ],
)
def test_only_what_is_needed_is_loaded(code: str, spared: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = set(done.stdout.split())
    assert "spool_core.errors" in loaded  # else nothing below could fail
    assert loaded & set(spared) == set()
