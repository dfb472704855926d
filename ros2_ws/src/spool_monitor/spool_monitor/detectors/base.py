"""What every detector has in common."""

from __future__ import annotations

import enum
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from spool_estimator.estimate import Estimate
from spool_stream.quantity import Quantity

from spool_monitor.alarms.event import Severity, Text
from spool_monitor.drift import Baseline, ParameterDrift
from spool_monitor.settings import MonitorSettings
from spool_monitor.signals.channel_signals import Signals
from spool_monitor.signals.response import Response
from spool_monitor.signals.spectrum import Line

#: What a moment may show anew.
SIGNALS, LINE, ESTIMATE = "signals", "line", "estimate"


class Judgement(enum.IntEnum):
    """How far a detector can judge now; the texts are those in ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    JUDGED = 1
    LEARNING = 2  # what is healthy is not known yet
    NOT_EXCITED = 3  # the machine does not shake enough to tell
    NOT_JUDGED = 4  # something else makes a judgement meaningless, e.g. a sensor's fault or an unknown valve


#: What people read.
JUDGEMENT_TEXTS = {
    Judgement.UNKNOWN: "no data yet",
    Judgement.JUDGED: "judged",
    Judgement.LEARNING: "learning",
    Judgement.NOT_EXCITED: "not enough excitation",
    Judgement.NOT_JUDGED: "not judged",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """What a detector makes of a moment (``stamp``, ns); the condition's delays come on top.

    ``indicated`` is ``None`` where nothing is wrong; between ``indicated`` and ``released`` nothing changes.
    """

    stamp: int
    indicated: Severity | None
    released: bool
    cause: str
    quantity: Quantity
    message: Text


@dataclass(frozen=True, slots=True)
class Moment:
    """What there is to judge at ``stamp`` (ns); what is not new is ``None``.

    Attributes:
        line: the strongest line of the body; ``silent`` where it was looked for and there is none.
        signals: both channels of the last second.
        response: the response that fits the last seconds.
        usual: the last response that nothing spoke against, or the configured one.
        estimate: the estimator's parameters.
        natural_frequency: Hz, as estimated or as configured.
        velocity: of the spool in the body, m/s rms, last seen.
        distrust: why parameters can't be judged now, empty where they can.
        parameters: tests of the parameters, by name.
        learned: start values of what the channels show, by name.

    """

    stamp: int
    natural_frequency: float
    usual: Response
    parameters: dict[str, ParameterDrift]
    learned: dict[str, Baseline]
    line: Line | None = None
    silent: bool = False
    signals: Signals | None = None
    response: Response | None = None
    estimate: Estimate | None = None
    velocity: float = math.nan
    distrust: str = ""

    @property
    def described(self) -> bool:
        """Whether the valve's natural frequency is known, from its description or an estimate."""
        return self.usual.natural_frequency > 0.0


class Detector(ABC):
    """Judge one kind of trouble of one valve from moment to moment; time comes from the stamps.

    ``name`` tells it from others of its ``kind``; ``looks_at`` says which moments it is shown. ``rank``
    orders the detectors of one moment: what is judged first is doubted by nothing that comes later.
    ``needs_valve``: it is shown nothing until the valve's natural frequency is known.
    ``on_delay`` and ``off_delay`` are in s. ``suspicious`` says why detectors of a higher rank can't believe
    this moment, already before the event is raised; ``refuted`` that what it suspected was not so.
    """

    name: ClassVar[str]
    kind: ClassVar[str]
    looks_at: ClassVar[tuple[str, ...]]
    rank: ClassVar[int] = 9
    needs_valve: ClassVar[bool] = False
    on_delay: ClassVar[float] = 0.0
    off_delay: ClassVar[float] = 3.0

    def __init__(self, settings: MonitorSettings) -> None:
        self.settings = settings
        self.judgement = Judgement.UNKNOWN
        self.suspicious = ""
        self.refuted = False

    @abstractmethod
    def update(self, moment: Moment) -> Finding | None:
        """Judge ``moment``; ``None`` where it shows nothing to this detector."""

    def restart(self) -> None:
        """Take note that samples are missing before the next moment."""
        self.suspicious = ""


def judgement(moment: Moment, parameters: tuple[ParameterDrift, ...]) -> Judgement:
    """Return how far ``parameters`` can be judged now."""
    if moment.distrust:
        return Judgement.NOT_JUDGED
    if not all(one.baseline.frozen for one in parameters):
        return Judgement.LEARNING
    return Judgement.JUDGED if any(one.judged for one in parameters) else Judgement.NOT_EXCITED
