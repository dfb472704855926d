"""Detector: what all of them have in common, and the moment that they judge."""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar, NamedTuple

from spool_core.kernels.strokes import Stroke
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate

from spool_monitor.channels import ChannelLook, GainChange, Signals, ValveResponse
from spool_monitor.detectors.data_fault import KIND as DATA_FAULT
from spool_monitor.event import EventKind, Facts, Finding, Severity
from spool_monitor.orders import OrderTracker
from spool_monitor.parameter_drift import ParameterDrift
from spool_monitor.state_file import Baseline
from spool_monitor.window import Line


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
class MonitorLimit:
    """Limit that something is judged by; each is a parameter of the node ``monitor``.

    The file that needs it declares it: the registry finds it there. ``default``, ``minimum`` and ``maximum``
    are in ``unit``. A ``structural`` one changes only while the node is unconfigured.
    """

    name: str
    default: float
    description: str
    unit: str
    minimum: float
    maximum: float
    structural: bool = False


#: Needed by several detectors, or by what feeds them.
NATURAL_FREQUENCY = MonitorLimit(
    "natural_frequency", 0.0, "Start value until it is estimated; 0: from the valve's description.",
    "Hz", 0.0, 1e3, structural=True,
)  # fmt: skip
MINIMUM_BODY = MonitorLimit("minimum_body", 0.5, "Peak body acceleration that is judged.", "m/s^2", 0.0, 1e3)
FALSE_ALARM_INTERVAL = MonitorLimit(
    "false_alarm_interval",
    365.0,
    "Mean time between false alarms by drift: shorter reports sooner.",
    "d",
    0.1,
    36_500.0,
)
BASELINE_TIME = MonitorLimit(
    "baseline_time", 15.0, "Time of valid estimates for the start values.", "s", 3.0, 1e5, structural=True
)


def on_delay(kind: str, seconds: float) -> MonitorLimit:
    """Return the parameter of the on-delay of the events of ``kind``."""
    text = "Time that the condition, or an exceeded alarm limit, must last before it is reported."
    return MonitorLimit(f"{kind}_on_delay", seconds, text, "s", 0.0, 3600.0)


#: s without any judgement after which the level is unknown, and after which the event is raised.
BLIND, REPORTED = 10.0, 60.0


@dataclass(frozen=True, slots=True)
class DriftTest:
    """Drift test that a detector asks for: a parameter of the estimate against its start value.

    ``limit`` is the change that matters, relative to the start value where its unit is 1, else absolute in
    ``unit``, the parameter's. It sets the severity; :class:`ParameterDrift` finds when a change is certain.
    """

    parameter: str
    unit: str
    limit: MonitorLimit


class Moment(NamedTuple):
    """Moment of a valve at ``stamp`` (ns): what there is to judge; what is not new is ``None``.

    Attributes:
        line: the strongest line of the body; ``silent`` where it was looked for and there is none.
        signals: both channels of the last second.
        response: the response that fits the last seconds.
        reference: the last response that nothing spoke against, or the configured one.
        estimate: the estimator's parameters.
        natural_frequency: Hz, as estimated or as configured.
        distrust: why parameters can't be judged now, empty where they can.
        unjudged: for how long (s) no detector has been able to judge the valve's condition, and why.
        channels: what a look at the channels showed.
        explained: whether a fault of a sensor or of the data is raised, which says why.
        parameters: tests of the parameters, by name.
        learned: start values of what the channels show, by name.
        orders: names the order of the machine that a line is.
        strokes: those that ended.
        gain: what is known of the channels' gain against its start value.

    """

    stamp: int
    natural_frequency: float
    reference: ValveResponse
    parameters: dict[str, ParameterDrift]
    learned: dict[str, Baseline]
    line: Line | None = None
    silent: bool = False
    signals: Signals | None = None
    response: ValveResponse | None = None
    estimate: Estimate | None = None
    distrust: str = ""
    unjudged: tuple[float, str] = (0.0, "")
    explained: bool = False
    channels: ChannelLook | None = None
    orders: OrderTracker | None = None
    strokes: tuple[Stroke, ...] = ()
    gain: GainChange = GainChange()

    @property
    def described(self) -> bool:
        """Whether the valve's natural frequency is known, from its description or an estimate."""
        return self.reference.natural_frequency > 0.0


class Detector(ABC):
    """Detector of one kind of trouble of one valve, moment by moment; time comes from the stamps.

    ``name`` distinguishes it from others of its ``kind``; it is shown what is new of ``looks_at``.
    ``parts`` names its faults where it has several, e.g. one for each channel: each has its own condition.
    ``rank`` orders the detectors of one moment: what is judged first is doubted by nothing that comes later.
    What keeps which other from judging is a table in :mod:`.unknowable`.
    ``needs_valve``: it is shown nothing until the valve's natural frequency is known. ``drifts`` are the
    tests of parameters that it needs; ``learns`` names what of the channels needs a start value, with units.
    ``on_delay`` and ``off_delay`` are in s, the former a number or the parameter that has it. ``suspicious``
    says why others can't believe this moment, already before the event is raised; ``refuted`` that what it
    suspected was not so. What ``stays`` is active until somebody acknowledges it;
    meanwhile it is ``held``, and nothing may be learned from what it sees.
    """

    name: ClassVar[str]
    kind: ClassVar[EventKind]
    looks_at: ClassVar[tuple[str, ...]]
    parts: ClassVar[tuple[str, ...]] = ("",)
    rank: ClassVar[int] = 9
    needs_valve: ClassVar[bool] = False
    drifts: ClassVar[tuple[DriftTest, ...]] = ()
    learns: ClassVar[Mapping[str, str]] = MappingProxyType({})
    on_delay: ClassVar[float | MonitorLimit] = 0.0
    off_delay: ClassVar[float] = 3.0
    stays: ClassVar[bool] = False

    def __init__(self, settings: MonitorSettings) -> None:
        self.settings = settings
        self.judgement = Judgement.UNKNOWN
        self.suspicious = ""
        self.refuted = False
        self.held = False

    @property
    def delay(self) -> float:
        """The on-delay, s."""
        return self.settings[self.on_delay] if isinstance(self.on_delay, MonitorLimit) else self.on_delay

    @property
    def shown(self) -> dict[str, float]:
        """What people read of a time that is judged, s, by ends of its name; mostly nothing."""
        return {}

    @classmethod
    def fault(cls, part: str = "") -> str:
        """Return the name of the condition of ``part``; without one, what all of them begin with."""
        own = "" if cls.name == cls.kind.name else cls.name
        return "/".join(filter(None, (cls.kind.name, own, part)))

    @abstractmethod
    def update(self, moment: Moment) -> Finding | tuple[Finding, ...] | None:
        """Judge ``moment``, each part by itself; ``None`` where it shows nothing to this detector."""

    def restart(self) -> None:
        """Start again: samples are missing before the next moment."""
        self.suspicious = ""

    def relearn(self) -> None:
        """Forget what the healthy valve is."""
        self.suspicious = ""

    @classmethod
    def check(cls, settings: MonitorSettings) -> None:
        """Refuse limits that contradict each other.

        Raises:
            InputError: both are named.

        """
        del settings


def judgement(distrust: str, parameters: Iterable[ParameterDrift]) -> Judgement:
    """Return how far all of ``parameters`` can be judged now; ``distrust`` says why none can, if it does."""
    parameters = tuple(parameters)
    if distrust or any(one.incomparable for one in parameters):
        return Judgement.NOT_JUDGED
    if not all(one.baseline.frozen for one in parameters):
        return Judgement.LEARNING
    return Judgement.JUDGED if any(one.judged for one in parameters) else Judgement.NOT_EXCITED


class MonitorSettings:
    """Settings of one valve's monitor, e.g. ``MonitorSettings(coulomb_change=0.2)[COULOMB_CHANGE]``.

    Limits that are not given have their defaults. The detectors' registry checks names and contradictions.
    """

    def __init__(self, **values: float) -> None:
        self.given: Mapping[str, float] = values

    def __getitem__(self, limit: MonitorLimit) -> float:
        """Return the value of ``limit``, in its unit."""
        return self.given.get(limit.name, limit.default)

    def changed(self, limit: MonitorLimit, value: float) -> MonitorSettings:
        """Return the same settings but for ``limit``."""
        return MonitorSettings(**{**self.given, limit.name: value})


class NotJudged(Detector):
    """The time since any detector of the valve's condition could judge; rest is a judgement.

    A fault of a sensor or of the data that is raised already says why: then this event is not raised as well,
    and its time begins when that fault is over.
    """

    name = "not_judged"
    kind = DATA_FAULT
    looks_at = ("line",)
    rank = 99
    _explained = 0

    def update(self, moment: Moment) -> Finding:
        """Judge for how long nothing was."""
        self.judgement = Judgement.JUDGED
        seconds, reason = moment.unjudged
        self._explained = moment.stamp if moment.explained else min(self._explained, moment.stamp)
        unexplained = min(seconds, 1e-9 * (moment.stamp - self._explained))
        raised = Severity.WARNING if unexplained >= REPORTED else None
        unjudged = Quantity("unjudged_time", "s", seconds, validity=Validity.VALID)
        return Finding(
            moment.stamp,
            raised,
            seconds == 0.0,
            "not_judged",
            unjudged,
            replace(Facts.of(unjudged, REPORTED), note=reason or "judged_again"),
        )
