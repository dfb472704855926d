from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from spool_evaluation.pictures import effect_pictures
from spool_evaluation.pictures.law_pictures import FORCE, PAGE, REST, draw, law_text
from spool_gap.catalogue import EFFECTS
from spool_sim.terms import TERMS
from spool_sim.valve import find_valve

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_pages_say_what_the_registered_laws_and_effects_say() -> None:
    # CONTRIBUTING.md has the commands that make them.
    assert PAGE.written(DOCS / "methods").strip() == law_text().strip()
    assert effect_pictures.PAGE.written(DOCS).strip() == effect_pictures.effects_text().strip()


def test_every_law_and_effect_has_its_picture() -> None:
    assert {path.stem for path in (DOCS / "methods" / "laws").glob("*.png")} == set(TERMS)
    assert {path.stem for path in (DOCS / "effects").glob("*.png")} == {
        name for name, entry in EFFECTS.items()
    }


@pytest.mark.parametrize("name", sorted(TERMS))
def test_picture_shows_a_force_over_something_with_units(name: str) -> None:
    figure = draw(TERMS[name], find_valve("4weh10_soft"))
    (axis,) = figure.axes
    assert axis.get_ylabel() == "force, N"
    assert re.search(r", (m/s²|m/s|mm|s)\b", axis.get_xlabel())
    laws = [line for line in axis.get_lines() if line.get_color() in (FORCE, REST)]
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in laws])
    assert np.isfinite(drawn).all()
    assert drawn.any()


def test_a_page_is_written_anew_between_its_marks(tmp_path: Path) -> None:
    begin, end = PAGE.marks
    page = tmp_path / "physics.md"
    page.write_text(f"above\n{begin}\nold\n{end}\nbelow\n", encoding="utf-8")
    PAGE.write(tmp_path, "new", {"spring": draw(TERMS["spring"], find_valve("4weh10_soft"))})
    assert page.read_text(encoding="utf-8") == f"above\n{begin}\n\nnew\n{end}\nbelow\n"
    assert [path.name for path in (tmp_path / "laws").iterdir()] == ["spring.png"]
