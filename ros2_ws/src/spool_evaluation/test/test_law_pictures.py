from __future__ import annotations

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from spool_evaluation.pictures import convergence_picture
from spool_evaluation.pictures.law_pictures import BEGIN, END, draw, law_text, main
from spool_sim.terms import TERMS
from spool_sim.valve.description import find_valve

DOCS = Path(__file__).resolve().parents[4] / "docs"


def test_page_says_what_the_registered_laws_say() -> None:
    page = (DOCS / "physics.md").read_text(encoding="utf-8")
    written = page.partition(BEGIN)[2].partition(END)[0]
    # Made anew with: python -m spool_evaluation.pictures.law_pictures docs
    assert written.strip() == law_text().strip()


def test_every_law_has_its_picture_and_every_link_leads_somewhere() -> None:
    page = (DOCS / "physics.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)\)", page)
    assert {f"laws/{name}.png" for name in TERMS} <= set(links)
    for link in links:
        assert (DOCS / link).is_file(), link


@pytest.mark.parametrize("name", sorted(TERMS))
def test_picture_shows_a_force_over_something_with_units(name: str) -> None:
    figure = draw(TERMS[name], find_valve("4weh10_soft"))
    plt.close(figure)
    (axis,) = figure.axes
    assert axis.get_ylabel() == "force, N"
    assert re.search(r", (m/s²|m/s|mm|s)\b", axis.get_xlabel())
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axis.get_lines()])
    assert np.isfinite(drawn).all()
    assert np.ptp(drawn) > 0.0


def test_pages_are_written_anew_between_the_marks(tmp_path: Path) -> None:
    page = tmp_path / "physics.md"
    page.write_text(f"above\n{BEGIN}\nold\n{END}\nbelow\n", encoding="utf-8")
    assert main([str(tmp_path)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.startswith("above\n")
    assert text.endswith(f"{END}\nbelow\n")
    assert "old" not in text.split()
    assert {path.stem for path in (tmp_path / "laws").glob("*.png")} == set(TERMS)


def test_errors_in_the_picture_fall_with_the_fourth_power() -> None:
    found = convergence_picture.errors("coulomb", {})
    assert np.log2(found[0] / found[3]) / 3.0 > 3.7
