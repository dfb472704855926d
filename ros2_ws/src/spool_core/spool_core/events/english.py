"""Languages of an event's sentences: what each has to say, and the words and templates of English."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple


class EventText(NamedTuple):
    """Texts of an event's number: its title, what it means on the machine, and what to do."""

    title: str
    meaning: str = ""
    advice: str = ""


@dataclass(frozen=True, slots=True)
class Language:
    """Language of an event's sentences.

    Attributes:
        code: ISO 639-1, e.g. ``de``.
        decimal: mark between an integer part and its decimals.
        raised, cleared: templates of headlines.
        events: texts by an event's number; a cause takes what it leaves empty from its kind.
        parameters: names of what is judged.
        words: what codes mean: causes, subjects, notes, urgencies, units of time.
        labels: of the details.
    """

    code: str
    decimal: str
    raised: str
    cleared: str
    events: Mapping[int, EventText]
    parameters: Mapping[str, str]
    words: Mapping[str, str]
    labels: Mapping[str, str]

    def event(self, code: int) -> EventText:
        """Return the texts of the number ``code``; empty where there are none."""
        kind = self.events.get(code - code % 100, EventText(""))
        own = self.events.get(code, kind)
        return EventText(own.title or kind.title, own.meaning or kind.meaning, own.advice or kind.advice)

    def word(self, code: str) -> str:
        """Return what ``code`` means; a code without an entry is its own text."""
        return self.words.get(code) or self.parameters.get(code) or code.replace("_", " ")

    def parameter(self, name: str) -> str:
        """Return the name of the parameter ``name``."""
        return self.parameters.get(name) or name.replace("_", " ")


EVENTS = {
    100: EventText(
        "Resonance",
        "The machine shakes the valve at the natural frequency of spool and springs.",
        "change the machine's speed, damp or move the valve's mounting, or fit the other springs",
    ),
    200: EventText("Friction drift"),
    201: EventText(
        "Friction drift (wear)",
        "The gap between spool and bore has grown, so the oil film drags less at the same temperature.",
        "measure the internal leakage, check the oil's cleanliness class, plan to replace the spool",
    ),
    202: EventText(
        "Friction drift (oil contamination)",
        "Particles or varnish rub in the gap; dry friction rises and the spool begins to stick.",
        "take an oil sample (ISO 4406), change the filter, flush, clean the spool",
    ),
    203: EventText(
        "Friction drift (oil viscosity)",
        "The drag of the oil film changed by more than its temperature explains.",
        "check the oil's grade and age, water and fuel in it, and the thermometer",
    ),
    204: EventText(
        "Friction drift (unknown cause)",
        "Friction changed in a way that no known cause explains.",
        "compare with the last maintenance, and learn a new baseline if the change was intended",
    ),
    300: EventText("Spring change"),
    301: EventText(
        "Spring change (softer)",
        "A centring spring has lost stiffness, or one of the pair is broken.",
        "replace both springs",
    ),
    302: EventText(
        "Spring change (stiffer)",
        "The spool is held by more than its springs, or other springs were fitted.",
        "check which springs are fitted and whether one is coil-bound or dirty",
    ),
    400: EventText(
        "Stuck spool",
        "The machine shakes and the spool does not move in its body.",
        "stop the machine safely, move the spool by its manual override, dismount and clean it",
    ),
    500: EventText(
        "Model gap",
        "A force acts that the model does not have.",
        "record a minute of it, and let ./spool gap name what is missing",
    ),
    600: EventText("Sensor fault"),
    601: EventText(
        "Dead sensor",
        "A channel shows no vibration though the other one does, or its samples do not change at all.",
        "check cable, plug and supply of the accelerometers and whether the acquisition runs",
    ),
    602: EventText(
        "Clipping sensor",
        "A channel is cut off at its full scale.",
        "choose a larger range or a less sensitive accelerometer",
    ),
    603: EventText(
        "Sensor offset",
        "The mean of a channel has moved, which no vibration does.",
        "check supply, temperature and mounting of that accelerometer",
    ),
    604: EventText(
        "Swapped sensors",
        "The channels show a spool that drives its body; body and spool are exchanged, or one is turned.",
        "check the wiring and the direction of both accelerometers",
    ),
    605: EventText(
        "Sensor scale",
        "The ratio of the channels' sensitivities has changed.",
        "check mounting and sensitivity setting of both accelerometers, calibrate them side by side",
    ),
    606: EventText(
        "Same channel",
        "Both channels carry the readings of one sensor.",
        "check the wiring and which channel of the acquisition each topic carries",
    ),
    607: EventText(
        "Wrap-around",
        "The integers of a channel wrap around: beyond its range it jumps to the other end.",
        "choose a larger range, or read the counts with the width and sign that the converter has",
    ),
    608: EventText(
        "Wrong sensitivity",
        "The sensitivity of one channel is wrong: the spool follows its body with a factor.",
        "check sensitivity, range and unit of both accelerometers, calibrate them side by side",
    ),
    609: EventText(
        "AC coupling",
        "One channel is coupled through a high-pass, the other is not; this biases the damping.",
        "set both channels to DC coupling, or both to the same lower limit",
    ),
    700: EventText(
        "Data fault", "Blocks were lost or could not be used.", "check network and measuring computer"
    ),
    701: EventText(
        "Wrong sample rate",
        "The sample period contradicts the time stamps; nothing is estimated from such data.",
        "correct the sample period that the source sends",
    ),
    702: EventText(
        "Second source",
        "Two sources or estimators send, or blocks or estimates name another valve; one is used.",
        "end the second source or give it the namespace of its valve",
    ),
    703: EventText(
        "Lost blocks",
        "Blocks were lost on the way, as jumps in the sequence show.",
        "check network and load of the measuring computer",
    ),
    704: EventText(
        "Malformed blocks",
        "Blocks had wrong lengths, samples, period or time stamps, or a clock was set.",
        "check the driver of the acquisition and the clock that its stamps come from",
    ),
    705: EventText(
        "Outliers",
        "Single samples are impossible; they are left out, the others are used.",
        "check plugs and cables, interference, and what the driver sends where it has no reading",
    ),
    706: EventText(
        "Repeated samples",
        "A channel repeats its samples: the sensor is polled faster than it samples.",
        "poll the sensor at its own rate, or send the rate at which it samples",
    ),
    707: EventText(
        "Clock step",
        "The clock of one sensor was set against the other's; nothing is estimated from such data.",
        "synchronise the clocks of both sensors, then restart the adapter",
    ),
    708: EventText(
        "Clock drift",
        "The clock of one sensor runs faster than the other's; delays and damping are wrong ever more.",
        "sample both sensors with one clock, or stamp each by its own",
    ),
    710: EventText(
        "Not judged",
        "Blocks arrive, but no detector has been able to judge the valve for a minute.",
        "remove the cause that the alarm's remark names; until then nothing is known of the valve",
    ),
    800: EventText("No data", "No data arrive.", "check whether the source runs"),
    801: EventText("No acceleration"),
    802: EventText("No estimates"),
    803: EventText(
        "Acceleration never seen",
        "No acceleration has ever arrived.",
        "check the topic name, its type and quality of service, and whether the source runs",
    ),
}

PARAMETERS = {
    "amplification": "amplification",
    "viscous_coefficient": "viscous coefficient",
    "coulomb_force": "Coulomb force",
    "spring_stiffness": "spring stiffness",
    "relative_motion": "relative motion",
    "residual": "unexplained force",
    "channel_level": "signal level",
    "flat_share": "flat tops",
    "offset_change": "change of mean",
    "dissipation": "apparent damping",
    "gain_change": "gain change",
    "channel_difference": "channel difference",
    "jump": "jump",
    "equal_samples": "equal samples",
    "spool_over_body": "spool over body",
    "corner_frequency": "corner frequency",
    "clock_step": "clock step",
    "clock_drift": "clock drift",
    "period_departure": "period error",
    "faulty_blocks": "faulty blocks",
    "second_estimates": "estimates of another estimator",
    "lost_blocks": "lost blocks",
    "refused_blocks": "refused blocks",
    "outliers": "outliers",
    "unjudged_time": "time without judgement",
    "silence": "silence",
    "dominant_frequency": "shaking frequency",
    "natural_frequency": "natural frequency",
    "expected_amplification": "expected amplification",
    "relative_displacement": "motion of the spool in the body",
    "body_acceleration": "body acceleration (rms)",
    "shown_acceleration": "shown acceleration (rms)",
    "expected_acceleration": "expected acceleration (rms)",
    "unchanged_time": "time without a change",
    "body_mean": "mean of the body",
    "spool_mean": "mean of the spool",
    "viscous_coefficient_change": "change of the viscous coefficient",
    "coulomb_force_change": "change of the Coulomb force",
    "oil_temperature_change": "change of the oil temperature",
    "outlier": "impossible sample",
    "signal_span": "half span of the signal",
    "body_outliers": "outliers of the body",
    "spool_outliers": "outliers of the spool",
}

WORDS = {
    "body": "body",
    "spool": "spool",
    "both": "both",
    "acceleration": "acceleration",
    "estimate": "estimate",
    "wear": "wear",
    "oil_contamination": "oil contamination",
    "oil_viscosity": "oil viscosity",
    "unknown": "unknown",
    "softer": "softer",
    "stiffer": "stiffer",
    "none": "none",
    "planned": "at the next planned stop",
    "soon": "soon",
    "immediate": "immediately",
    "alarm_passed": "already passed",
    "no_trend": "unknown: no steady trend",
    "at_rest": "the machine is at rest",
    "arrives_again": "data arrive again",
    "judged_again": "detectors judge the valve again",
    "not_seen_any_more": "the fault is not seen any more",
    "changes_again": "both accelerometers change from sample to sample",
    "oil_referred": "compared at the same oil temperature",
    "oil_temperature_frozen": (
        "the thermometer shows the same as before the change: if it is frozen, warm oil looks like wear"
    ),
    "oil_temperature_unknown": "the oil temperature is unknown, so thinner oil may look like wear",
    "seconds": "s",
    "minutes": "min",
    "hours": "h",
    "days": "days",
}

LABELS = {
    "measured": "Measured",
    "baseline": "Healthy valve",
    "change": "Change",
    "limit": "Limit",
    "began": "Began",
    "earlier": "{time} before this message",
    "lasted": "Lasted",
    "causes": "Possible causes",
    "evidence": "Further numbers",
    "note": "Remark",
    "false_alarm_interval": "Expected false-alarm interval",
    "urgency": "Urgency",
    "time_to_limit": "Time to the alarm limit",
    "meaning": "Meaning",
    "advice": "What to do",
    "interval": "{low} to {high}, 95 %",
    "number": "number {code}",
    "unknown": "unknown",
}

ENGLISH = Language(
    code="en",
    decimal=".",
    raised="{title}: {parameter} {value}, limit {limit}",
    cleared="{title}, over: {parameter} {value}, limit {limit}",
    events=EVENTS,
    parameters=PARAMETERS,
    words=WORDS,
    labels=LABELS,
)
