"""Clipping channel: its tops are flat, at the same level again and again."""

from __future__ import annotations

from collections import deque
from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.event import EventCause, Facts, Finding, Severity

from .base import MINIMUM_BODY, SIGNALS, Detector, Judgement, Moment, MonitorSettings
from .sensor_fault import sensor_fault

KIND = sensor_fault(EventCause("clipping", 602))


#: Windows that are looked back on, and how many of them must show a flat top.
WINDOWS, FLAT = 6, 3

#: Share of flat samples below which a window shows none.
LEAST = 0.006


class SensorClipping(Detector):
    """Look for flat tops in each window; a machine does not clip at every moment."""

    name = "sensor_clipping"
    kind = KIND
    looks_at = (SIGNALS,)
    rank = 1
    off_delay: ClassVar[float] = 15.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._flat: deque[tuple[str, float]] = deque(maxlen=WINDOWS)

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        signals = moment.signals
        if signals is None:
            return None
        channels = {"body": signals.body, "spool": signals.spool}
        name = max(channels, key=lambda one: channels[one].flat_top)
        share, loud = (channels[name].flat_top, channels[name].rms >= self.settings[MINIMUM_BODY])
        self.judgement = Judgement.JUDGED if loud else Judgement.NOT_EXCITED
        self._flat.append((name, share if loud else 0.0))
        flat = [(one, value) for one, value in self._flat if value >= LEAST]
        self.suspicious = f"the {flat[-1][0]} accelerometer clips" if flat else ""
        latest = flat[-1] if flat else (name, 0.0)
        flatness = Quantity("flat_share", "1", latest[1], validity=Validity.VALID)
        return Finding(
            moment.stamp,
            Severity.ALARM if len(flat) >= FLAT else None,
            not flat,
            "clipping",
            flatness,
            lambda: Facts.of(flatness, LEAST, latest[0]),
        )

    def restart(self) -> None:
        """Forget the windows before a gap."""
        super().restart()
        self._flat.clear()
