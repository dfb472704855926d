"""Another distribution adds laws by entry points, without a file in these sources."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def added(folder: Path, group: str, module: str, text: str) -> dict[str, str]:
    """Install a distribution that adds ``module`` to the package ``group``; return the environment."""
    (folder / f"{module}.py").write_text(text, encoding="utf-8")
    metadata = folder / "machine_builder-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: machine-builder\nVersion: 1.0\n", "utf-8"
    )
    (metadata / "entry_points.txt").write_text(f"[{group}]\nown = {module}\n", "utf-8")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}


def run(code: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )


LAW = """
from dataclasses import replace
from spool_sim.terms.springs import SPRING

RUST = replace(SPRING, name="rust")
"""


def test_another_distribution_adds_a_law(tmp_path: Path) -> None:
    environment = added(tmp_path, "spool_sim.terms", "rusty_laws", LAW)
    code = "from spool_sim.terms import TERMS; print('rust' in TERMS, 'spring' in TERMS)"
    done = run(code, environment)
    assert done.stdout.split() == ["True", "True"], done.stderr


def test_what_another_distribution_adds_and_cannot_be_loaded_is_named_with_it(tmp_path: Path) -> None:
    environment = added(tmp_path, "spool_sim.terms", "broken_laws", "import a_library_that_is_missing\n")
    done = run("import spool_sim.terms", environment)
    assert "machine-builder adds broken_laws to spool_sim.terms, which cannot be loaded" in done.stderr
    assert "repair or uninstall machine-builder" in done.stderr
