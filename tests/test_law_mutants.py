"""A sample of the mutants of the laws: each one fails a reference value. The nightly run takes all."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).with_name("law_mutants.py")


def mutate(*options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "ignore", str(TOOL), *options], capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_a_reference_value_notices_every_mutant_of_a_sample() -> None:
    done = mutate("--every", "79")
    assert (done.returncode, done.stderr) == (0, "")
    counted = re.search(r"\| all \| (\d+) \| (\d+) \| (\d+) \|", done.stdout)
    assert counted
    made, noticed, equivalent = map(int, counted.groups())
    assert made == noticed + equivalent
    assert made > 40


def test_a_law_that_is_ten_per_cent_wrong_is_among_the_mutants() -> None:
    listing = "import law_mutants; print([m.after for m in law_mutants.mutants_of('spool_sim.terms.{}')])"
    found = [
        subprocess.run(
            [sys.executable, "-c", listing.format(name)],
            cwd=TOOL.parent,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for name in ("friction", "paper_friction")
    ]
    assert "return 0.9 * coulomb_force" in found[0]
    assert "(hess_soom_static - hess_soom_minimum) / (1.0 + ratio)" in found[1]
