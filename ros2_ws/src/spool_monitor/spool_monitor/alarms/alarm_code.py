"""The list of alarms: a stable number, the NAMUR NE 107 status and the latch of each."""

from __future__ import annotations

import enum
from types import MappingProxyType

from spool_estimator.gap_requests.gap_watch import MODEL_GAP, MODEL_GAP_CODE


class Namur(enum.IntEnum):
    """Status signal after NAMUR NE 107, a worse one above; numbers as in ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    NORMAL = 1
    MAINTENANCE_REQUIRED = 2  # M: works, but its reserve is running out
    OUT_OF_SPECIFICATION = 3  # S: is operated outside of what it was made for
    FUNCTION_CHECK = 4  # C: for now not valid, somebody works on it or it learns
    FAILURE = 5  # F: the signal is not valid

    @property
    def letter(self) -> str:
        """The letter that people know the status by; empty where all is well or nothing is known."""
        return {5: "F", 4: "C", 3: "S", 2: "M"}.get(int(self), "")


_M, _S, _F = Namur.MAINTENANCE_REQUIRED, Namur.OUT_OF_SPECIFICATION, Namur.FAILURE

#: Number and status by kind and cause; a cause that is not listed has the kind's own, under "".
#: A number once given never changes its meaning; new ones are put behind.
ALARMS: MappingProxyType[str, dict[str, tuple[int, Namur]]] = MappingProxyType(
    {
        "resonance": {"": (100, _S)},
        "friction_drift": {
            "": (200, _M),
            "wear": (201, _M),
            "oil_contamination": (202, _M),
            "oil_viscosity": (203, _S),
            "unknown": (204, _M),
        },
        "spring_change": {"": (300, _M), "softer": (301, _M), "stiffer": (302, _M)},
        "stuck_spool": {"": (400, _F)},
        MODEL_GAP: {"": (MODEL_GAP_CODE, _S)},
        "sensor_fault": {
            "": (600, _F),
            "dead": (601, _F),
            "clipping": (602, _F),
            "offset": (603, _F),
            "swapped": (604, _F),
            "scale": (605, _F),
        },
        "data_fault": {
            "": (700, _S),
            "rate": (701, _F),
            "source": (702, _S),
            "lost": (703, _S),
            "malformed": (704, _S),
        },
        "stale": {
            "": (800, _F),
            "acceleration": (801, _F),
            "estimate": (802, _F),
            "never_seen": (803, _F),
        },
    }
)

#: Of a kind that is not listed.
UNLISTED = (900, Namur.OUT_OF_SPECIFICATION)

#: Kinds that stay until somebody resets them, since the machine must not forget them by itself.
LATCHING = ("stuck_spool", "sensor_fault")


def code(kind: str, cause: str = "") -> int:
    """Return the stable number of an alarm."""
    return _entry(kind, cause)[0]


def namur(kind: str, cause: str = "") -> Namur:
    """Return the status that an active condition gives the valve."""
    return _entry(kind, cause)[1]


def _entry(kind: str, cause: str) -> tuple[int, Namur]:
    causes = ALARMS.get(kind)
    if causes is None:
        return UNLISTED
    return causes.get(cause, causes[""])
