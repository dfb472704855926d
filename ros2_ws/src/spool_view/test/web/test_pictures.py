"""Pictures of the page in the documentation: they show the labels that the page has today.

They are made again, with the labels, by this command:

    SPOOL_PICTURES=docs/pictures ./spool test ros2_ws/src/spool_view/test/web/test_pictures.py -n0
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from spool_msgs.msg import AlarmList

from .conftest import Domain, StandIn, alarm, good_health, quantity, tracking

PICTURES = Path(__file__).parents[5] / "docs" / "pictures"
#: Heights (px) by view and width.
HEIGHTS = {("machine", 1280): 620, ("machine", 390): 900, ("valve", 1280): 1400, ("valve", 390): 900}
#: ms until spectra are drawn.
SETTLES = 15_000
LABELS = """Array.from(document.querySelectorAll("h1, h2, h3, th, button, nav a, dt, summary"))
    .filter(one => !one.closest(".uplot")).map(one => one.innerText.trim())"""

pytestmark = pytest.mark.skipif(not PICTURES.is_dir(), reason="the package is away from the documentation")


def worn(valve: StandIn) -> None:
    """Let a valve have everything that its page can show: resonance, and every estimate."""
    valve.health = good_health("resonance", shakes=28.0)
    valve.health.level, valve.alarms = 3, AlarmList(alarms=[alarm()])
    estimate = valve.estimate = tracking()
    estimate.damping_ratio = quantity("damping_ratio", "1", 0.0409, 2e-4)
    estimate.oil_temperature = quantity("oil_temperature", "deg C", 46.2, 0.5)
    estimate.residual = quantity("residual", "1", 0.012)
    estimate.excitation = quantity("excitation", "m/s^2", 7.08)
    estimate.relative_displacement = quantity("relative_displacement", "m", 1.63e-3, 1e-5)
    estimate.referred_viscous_coefficient = quantity("referred_viscous_coefficient", "N s/m", 8.1, 0.1)


@pytest.mark.parametrize("view", ["machine", "valve"])
def test_pictures_of_the_page_show_its_labels_of_today(
    view: str, domain: Domain, stand_in: Callable[..., StandIn], open_page: Callable[..., Any]
) -> None:
    out = Path(os.environ["SPOOL_PICTURES"]) if "SPOOL_PICTURES" in os.environ else None
    shaken, _calm = stand_in("press/valve_2"), stand_in("press/valve_1")
    worn(shaken)
    if out:
        domain.start("spool_sim", "simulator", "-r", "__ns:=/press/valve_2", valve_file="4weh10_stiff")
    _, address = domain.page(operator=True)
    pages = {}
    for width in (1280, 390):
        for scheme in ("light", "dark") if out else ("light",):
            where = f"{address}valve/press/valve_2" if view == "valve" else address
            height = HEIGHTS[view, width]
            page = open_page(where, width=width, height=height, color_scheme=scheme, locale="en-GB")
            pages[f"page_{view}_{width}_{scheme}.png"] = page
    stated = (
        json.loads((PICTURES / "labels.json").read_text("utf-8"))
        if (PICTURES / "labels.json").exists()
        else {}
    )
    for page in pages.values():
        page.wait_for_selector("[data-alarm=resonance] [data-state=unacknowledged]")
        if view == "valve":
            page.wait_for_selector("tr[data-parameter=relative_displacement]", state="attached")
            page.wait_for_selector("#resonance dl + dl")
    for name, page in pages.items():
        if out:
            page.wait_for_timeout(SETTLES if page is next(iter(pages.values())) else 0)
            page.screenshot(path=out / name)
        labels = sorted(set(filter(None, page.evaluate(LABELS))))
        of_picture = hashlib.sha256(((out or PICTURES) / name).read_bytes()).hexdigest()
        if out:
            stated[name] = {"sha256": of_picture, "labels": labels}
        assert stated[name]["sha256"] == of_picture
        assert stated[name]["labels"] == labels, "make the pictures again, as above"
    if out:
        (out / "labels.json").write_text(
            json.dumps(stated, indent=1, ensure_ascii=False, sort_keys=True) + "\n", "utf-8"
        )
