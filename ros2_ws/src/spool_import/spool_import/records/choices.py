"""Choices of a user for an import, as they stand on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.units.units import Sensitivity, quantity_of

from .roles import SHORT, role_of


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices for an import, each by role.

    ``columns``: the file's own names, by role as given. ``units``: units that stand over those of the file.
    ``scales``: sensitivities. ``topics``: topic and axis. ``rate``: Hz, of samples without a time.
    ``align``: whether two clocks may be brought together.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, Sensitivity] = field(default_factory=dict)
    topics: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    rate: float | None = None
    align: bool = True

    def states_unit(self, role: str) -> bool:
        """Return whether ``--columns`` names a column by the role with its unit, e.g. ``body_m_s2``."""
        return role in self.columns


def choices(
    columns: str | None = None,
    unit: str | None = None,
    scale: str | None = None,
    topic: str | None = None,
    rate: float | None = None,
    align: str = "auto",
) -> Choices:
    """Return what the options of the same names say.

    Raises:
        InputError: one is not written as it should be.
    """
    units = {role_of(name): text for name, text in pairs("--unit", unit, "body=g,spool=g").items()}
    for text in units.values():
        if not quantity_of(text):
            raise InputError(
                f"--unit {printable(text, 30)!r}: not a unit that is known: e.g. g, m/s^2, mm/s^2, mV, ms"
            )
    scales = {}
    for name, text in pairs("--scale", scale, "body=100mV/g,spool=100mV/g").items():
        try:
            scales[role_of(name)] = Sensitivity(text)
        except InputError as error:
            raise InputError(f"--scale: {error}") from error
    if align not in ("auto", "none"):
        raise InputError(f"--align {printable(align, 20)!r}: write auto or none")
    topics = {}
    for name, text in pairs("--topic", topic, "body=/imu_1:z,spool=/imu_2:z").items():
        path, mark, axis = text.rpartition(":")
        if not (mark and path and axis):
            raise InputError(f"--topic {printable(text, 60)!r}: write it like body=/imu_1:z,spool=/imu_2:z")
        topics[role_of(name)] = (path, axis)
    if rate is not None and not 0.0 < rate < 1e7:
        raise InputError(f"--rate {rate:g}: give samples a second, above 0")
    return Choices(pairs("--columns", columns, _COLUMNS), units, scales, topics, rate, align == "auto")


_COLUMNS = "time_s=t,body_m_s2=ch1,spool_m_s2=ch2"


def pairs(option: str, text: str | None, example: str) -> dict[str, str]:
    """Return the pairs of ``name=value,name=value``.

    Raises:
        InputError: it is written otherwise.
    """
    if text is None:
        return {}
    found = [pair.partition("=") for pair in text.split(",")]
    for name, mark, value in found:
        if not (name.strip() and mark and value.strip()):
            raise InputError(f"{option} {printable(text, 100)!r}: write it like {example}")
    return {name.strip(): value.strip() for name, _, value in found}


def short(role: str) -> str:
    """Return the short name of a role, as ``--unit`` takes it."""
    return next(name for name, full in SHORT.items() if full == role)
