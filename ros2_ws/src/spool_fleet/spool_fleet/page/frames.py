"""Frames of the fleet's charts: their sizes, and axes that every chart uses."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from .scales import Scale, TimeScale

TEMPERATURE = "temperature"


@dataclass(frozen=True, slots=True)
class Frame:
    """Frame of a chart: its size and margins, px."""

    width: float
    height: float
    left: float = 0.0
    right: float = 0.0
    top: float = 2.0
    bottom: float = 2.0

    def x(self, share: float) -> float:
        """Return the place of ``share`` of the width."""
        return self.left + share * (self.width - self.left - self.right)

    def y(self, share: float) -> float:
        """Return the place of ``share`` of the height, kept within the frame."""
        return self.height - self.bottom - min(max(share, 0.0), 1.0) * (self.height - self.top - self.bottom)


LARGE = Frame(440.0, 190.0, 46.0, 58.0, 16.0, 24.0)
SMALL = Frame(200.0, 44.0)


def axes(frame: Frame, time: TimeScale, scale: Scale, name: str) -> Markup:
    """Return the axes of a chart of the parameter ``name``, without texts in a small one."""
    left, right = frame.left, frame.width - frame.right
    top, bottom = frame.top, frame.height - frame.bottom
    grid = "".join(f"M{left:g} {frame.y(scale.share(tick)):.1f}H{right:g}" for tick in scale.ticks)
    months = "".join(f"M{frame.x(time.share(day)):.1f} {bottom:g}v-4" for day, _ in time.ticks)
    drawn = [
        Markup('<path class="grid" d="{}"/><path class="edge" d="M{:g} {:g}V{:g}H{:g}{}"/>').format(
            grid, left, top, bottom, right, months
        )
    ]
    if frame is LARGE:
        for tick in scale.ticks:
            said = f"{tick:g} °C" if name == TEMPERATURE else f"{100.0 * (tick - 1.0):+.3g} %"
            text = "0 %" if name != TEMPERATURE and abs(tick - 1.0) < 1e-9 else said
            drawn.append(label(left - 4.0, frame.y(scale.share(tick)) + 3.5, text, "end"))
        for day, text in time.ticks:
            drawn.append(label(frame.x(time.share(day)), frame.height - 8.0, text, "middle"))
    return Markup().join(drawn)


def label(x: float, y: float, text: str, anchor: str) -> Markup:
    """Return a text at a place."""
    return Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(x, y, anchor, text)
