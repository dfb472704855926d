"""Pictures of a page that is served, for the documentation: two widths, light and dark.

python ros2_ws/src/spool_view/test/web/make_pictures.py http://127.0.0.1:8765/ valve_1 docs/pictures
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

#: Widths, px; s until spectra and trends are there.
WIDTHS, SETTLES = (1280, 390), 20.0


def main(address: str, valve: str, folder: Path) -> None:
    """Write ``page_VIEW_WIDTH_SCHEME.png`` of the machine and of ``valve``."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--headless", "--no-sandbox", "--disable-gpu"]
        )
        pages = []
        for view, path, heights in (("machine", "", (760, 900)), ("valve", f"valve/{valve}", (1500, 900))):
            for width, height in zip(WIDTHS, heights, strict=True):
                for scheme in ("light", "dark"):
                    size = {"width": width, "height": height}
                    context = browser.new_context(viewport=size, color_scheme=scheme, locale="en-GB")
                    page = context.new_page()
                    page.goto(f"{address}{path}")
                    pages.append((f"page_{view}_{width}_{scheme}.png", page))
        pages[0][1].wait_for_timeout(1000 * SETTLES)
        for name, page in pages:
            page.screenshot(path=folder / name)
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
