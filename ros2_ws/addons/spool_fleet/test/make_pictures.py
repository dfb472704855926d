"""Pictures of a fleet's page, for the documentation.

python ros2_ws/addons/spool_fleet/test/make_pictures.py fleet.html docs/pictures
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

#: Sizes, px.
SIZES = {"fleet_page": (1100, 1180), "fleet_valve": (1100, 900)}


def main(file: Path, folder: Path) -> None:
    """Write ``fleet_page.png``, and ``fleet_valve.png`` of the worst valve."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--headless", "--no-sandbox", "--disable-gpu"]
        )
        for name, (width, height) in SIZES.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(file.absolute().as_uri())
            if name == "fleet_valve":
                page.click("section[aria-labelledby=worst] tbody a")
                page.wait_for_selector("details[open] .large canvas")
            page.screenshot(path=folder / f"{name}.png")
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
