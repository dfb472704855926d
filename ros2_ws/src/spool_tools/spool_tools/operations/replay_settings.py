"""Settings of a replay: the limits and the estimator's parameters that a plant's nodes run with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spool_core.errors import InputError
from spool_estimator.estimator import phase_of, settings_for
from spool_estimator.estimators import make_estimator
from spool_estimator.gap_requests.gap_watch import GapWatch
from spool_estimator.stream_estimator import StreamEstimator
from spool_monitor.detectors import LIMITS, MonitorSettings, check_settings
from spool_monitor.detectors.settings import BASELINE_TIME, NATURAL_FREQUENCY
from spool_sim.valve.description import Valve

#: Parameters of the node `estimator` that change its estimates.
ESTIMATING = ("forgetting", "memory", "low_cut", "high_cut", "minimum_excitation", "period")


@dataclass(frozen=True, slots=True)
class ReplaySettings:
    """Settings of the replay of one valve: what differs from the shipped parameters, and why.

    ``monitor`` and ``estimator`` hold parameters of these nodes by name; ``file`` is the parameter file that
    they are from, empty where none was given.
    """

    monitor: Mapping[str, float] = field(default_factory=dict)
    estimator: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""

    def changed(self, *, method: str | None = None, baseline_time: float | None = None) -> ReplaySettings:
        """Return these settings but for what is given: the estimator's method, the baseline's time (s)."""
        estimator = self.estimator if method is None else {**self.estimator, "method": method}
        monitor = self.monitor
        if baseline_time is not None:
            monitor = {**monitor, BASELINE_TIME.name: baseline_time}
        return replace(self, monitor=monitor, estimator=estimator)

    def limits(self, valve: Valve) -> MonitorSettings:
        """Return the monitor's settings for ``valve``, whose frequency counts where no other is given."""
        frequency = self.monitor.get(NATURAL_FREQUENCY.name) or valve.natural_frequency
        return MonitorSettings(**{**self.monitor, NATURAL_FREQUENCY.name: frequency})

    def make_estimator(self, valve: Valve, name: str) -> StreamEstimator:
        """Return the estimator of ``valve`` in the namespace ``name``."""
        changes = {key: value for key, value in self.estimator.items() if key in ESTIMATING}
        method = self.estimator.get("method", "prediction")
        return make_estimator(method, settings_for(valve, phase=phase_of(name), **changes))

    def make_gap_watch(self) -> GapWatch:
        """Return what watches the residual."""
        return GapWatch(**{key: value for key, value in self.estimator.items() if key == "gap_growth"})

    def to_dict(self) -> dict[str, Any]:
        """Return what `replay --json` has of the settings: source, sentence, each limit with its unit."""
        return {
            "source": self.file or "shipped",
            "sentence": self.sentence(),
            "values": {
                name: {
                    "value": self.monitor.get(name, limit.default),
                    "unit": limit.unit,
                    "shipped": limit.default,
                }
                for name, limit in LIMITS.items()
                if name != NATURAL_FREQUENCY.name or name in self.monitor
            },
            "estimator": dict(self.estimator),
        }

    @property
    def source(self) -> str:
        """Where the limits are from."""
        return f"limits of {self.file}" if self.file else "limits as shipped"

    def sentence(self) -> str:
        """Return which limits the monitor judged by, in words."""
        limits = [(LIMITS[name], value) for name, value in self.monitor.items()]
        changed = [
            f"{limit.name} {_shown(value, limit.unit)} (shipped: {_shown(limit.default, limit.unit)})"
            for limit, value in limits
            if value != limit.default
        ]
        changed += [f"the estimator's {name} {value}" for name, value in self.estimator.items()]
        if not self.file:
            return f"{self.source}{', except ' if changed else ''}{', '.join(changed)}"
        if changed:
            return f"{self.source}: {', '.join(changed)}; all others as shipped"
        if self.monitor:
            return f"{self.source}, the same as shipped"
        return f"limits as shipped: {self.file} has none for this valve's monitor"


#: Settings of a replay that is given none.
SHIPPED = ReplaySettings()


def settings_from(file: Path | None, name: str) -> ReplaySettings:
    """Return the settings that the parameter file ``file`` gives the nodes in the namespace ``name``.

    Raises:
        InputError: the nodes would refuse the file.
    """
    if file is None:
        return SHIPPED
    # The nodes' own tables, which need ROS.
    from spool_core.node.managed_node import AUTOSTART  # noqa: PLC0415
    from spool_core.node.parameters import read_parameters  # noqa: PLC0415
    from spool_estimator.node.estimator_node import EstimatorNode  # noqa: PLC0415
    from spool_monitor.node.monitor_node import MonitorNode  # noqa: PLC0415

    space = f"/{name.strip('/')}"
    monitor = read_parameters(file, f"{space}/monitor", (AUTOSTART, *MonitorNode.PARAMETERS))
    estimator = read_parameters(file, f"{space}/estimator", (AUTOSTART, *EstimatorNode.PARAMETERS))
    limits = {key: value for key, value in monitor.items() if key in LIMITS and isinstance(value, float)}
    try:
        check_settings(MonitorSettings(**limits))
    except InputError as error:
        raise InputError(f"{file}: {space}/monitor: {error}") from None
    own = {key: estimator[key] for key in ("method", *ESTIMATING, "gap_growth") if key in estimator}
    defaults = {parameter.name: parameter.default for parameter in EstimatorNode.PARAMETERS}
    return ReplaySettings(
        limits, {key: value for key, value in own.items() if value != defaults[key]}, str(file)
    )


def _shown(value: float, unit: str) -> str:
    return f"{value:g}" if unit in ("", "1") else f"{value:g} {unit}"
