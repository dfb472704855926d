"""Diagnostic tasks of the node ``monitor``: what arrives, what the detectors say, the alarms."""

from __future__ import annotations

from collections.abc import Iterable

from spool_core.block_gate import BlockGate
from spool_core.node.diagnostics import Level, Status, block_faults, block_values, key
from spool_core.uncertainty import Quantity

from spool_monitor.detection import Detection
from spool_monitor.detectors import JUDGEMENT_TEXTS, Judgement
from spool_monitor.events.event import Severity
from spool_monitor.health import Health, HealthLevel

#: Of an active condition that is worst; without one all is well.
_LEVELS = {None: Level.OK, Severity.WARNING: Level.WARNING, Severity.ALARM: Level.ERROR}


def data_status(detection: Detection, gate: BlockGate, health: Health) -> Status:
    """Return what arrives, and whether the sensors can be believed."""
    sensors = _detector_status("data", detection, health, ())
    level, text = sensors.level, sensors.message
    faults = block_faults(gate)
    if health.level is HealthLevel.STALE:
        text = health.summary
    elif gate.accepted == 0:
        level, text = Level.WARNING, "waiting for data"
    elif level is Level.OK:
        level, text = (Level.WARNING, faults) if faults else (level, "no block lost or refused lately")
    return Status("data", level, text, {**block_values(gate), **sensors.values})


def condition_status(detection: Detection, health: Health) -> Status:
    """Return what is wrong with the valve and how it moves."""
    shown = (
        health.dominant_frequency, health.amplification, health.natural_frequency, health.viscous_drift,
        health.coulomb_drift,
    )  # fmt: skip
    return _detector_status("condition", detection, health, shown)


def _detector_status(task: str, detection: Detection, health: Health, shown: Iterable[Quantity]) -> Status:
    """Return what the detectors of ``task`` say; what they can't judge is said as well."""
    ours = [one for one in detection.detectors if one.kind.task == task]
    conditions = [detection.conditions[one.name] for one in ours]
    active = [condition for condition in conditions if condition.active is not None]
    worst = max((condition.active for condition in active if condition.active is not None), default=None)
    level = _LEVELS[worst]
    text = ", ".join(f"{one.kind} {one.cause}".strip().replace("_", " ") for one in active)
    if not text:
        open_ = {one.judgement for one in ours if one.judgement is not Judgement.JUDGED}
        text = ", ".join(JUDGEMENT_TEXTS[judgement] for judgement in sorted(open_)) or "nothing found"
    if health.level is HealthLevel.UNKNOWN and not active:
        level = Level.WARNING
    if health.level is HealthLevel.STALE:
        level, text = Level.STALE, "no data"
    return Status(
        task,
        level,
        text,
        {
            **{key(value.name, value.unit): value.value for value in shown},
            **{f"{one.name}_judgement": JUDGEMENT_TEXTS[one.judgement] for one in ours},
        },
    )
