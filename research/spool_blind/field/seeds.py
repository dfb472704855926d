"""Windows of seeds: what a field case may be used for, so that no reported error was seen by a choice."""

from __future__ import annotations

#: Seeds by window: confidence is calibrated on the first, checked on the second; the third is touched by no
#: choice and gives the errors that are reported. All others are development.
WINDOWS: dict[str, range] = {
    "calibration": range(100_000, 200_000),
    "check": range(200_000, 300_000),
    "report": range(300_000, 400_000),
}
DEVELOPMENT = "development"


def window_of(seed: int) -> str:
    """Return the window that ``seed`` belongs to, a key of ``WINDOWS`` or ``DEVELOPMENT``."""
    return next((name for name, seeds in WINDOWS.items() if seed in seeds), DEVELOPMENT)
