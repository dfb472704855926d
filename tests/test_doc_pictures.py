"""Pictures of the documentation: each has its labels beside it, and what makes the page still has them.

Those of the operator's page are made and compared by ``spool_view/test/web/test_pictures.py``. That of the
gap report is the top, 1100 px wide, of the page of ``./spool gap first_record --report gap.html``; the record
is made by ``./spool simulate --coulomb-force 0.5 --excitation sweep --seconds 40 --out first_record``.
That of what-if is ``plot().save()`` of ``spool.what_if`` with the springs of the first command of its page.
"""

import hashlib
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "pictures"
STATED = json.loads((PICTURES / "labels.json").read_text("utf-8"))


@pytest.mark.parametrize("name", sorted(STATED))
def test_a_picture_is_the_one_whose_labels_are_stated(name: str) -> None:
    assert hashlib.sha256((PICTURES / name).read_bytes()).hexdigest() == STATED[name]["sha256"]


@pytest.mark.parametrize("name", ["gap_report.png", "what_if.png"])
def test_a_report_still_has_the_labels_of_its_picture(name: str) -> None:
    source = "".join(
        path.read_text("utf-8")
        for folder in ("src/spool_report/spool_report", "addons/spool_design/spool_design")
        for path in sorted((ROOT / "ros2_ws" / folder).rglob("*.py"))
    )
    missing = [label for label in STATED[name]["labels"] if label not in source]
    assert not missing, "make the picture again, as above"
