"""Thresholds: limits that the checks of a record compare with, each with its origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

#: Origin that several thresholds share. Blind cases are records of ``spool_blind``; those of the tables in
#: the documentation have other seeds than those that thresholds were chosen on.
CASES = "chosen on blind cases other than the published ones; not derived"


def decided(value: float, unit: str, decides: str, origin: str) -> Any:
    """Return a field of default ``value`` that carries its ``unit``, what it decides, and its origin."""
    return field(default=value, metadata={"unit": unit, "decides": decides, "origin": origin})


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds of the checks and the verdict; ``described`` returns each one's unit, use and origin."""

    # Checks of the record -------------------------------------------------------------------------------
    shortest: float = decided(
        6.0, "s", "length of all stretches below which a record is refused", "windows to fit and to hold out"
    )
    shortest_stretch: float = decided(
        4.0, "s", "length of a stretch below which it is left out", "a window and its settling"
    )
    excited: float = decided(5.0, "1", "rms over the noise's below which a channel shows only noise", CASES)
    samples_per_period: float = decided(
        25.0, "1", "samples per period of the natural frequency below which a record is refused", CASES
    )
    samples_per_excited_period: float = decided(
        3.0,
        "1",
        "samples per period of the highest frequency excited below which a record is refused",
        "above the two of Nyquist, with room for the anti-alias filter",
    )
    incoherent: float = decided(
        0.3,
        "1",
        "share of the spool's power that is coherent with the body, below which nothing is trusted",
        CASES,
    )
    unlike_described: float = decided(
        0.3, "ln", "distance of the transfer from the described valve's from which units are doubted", CASES
    )
    wrong_unit: float = decided(
        0.6, "1", "share of that distance that a factor of 9.81 may leave to be the reason", CASES
    )
    wrong_unit_everywhere: float = decided(
        0.85, "1", "the same where it lessens the distance of every spring", CASES
    )
    opposite: float = decided(
        -0.7, "1", "cosine to the expected transfer below which a sign is wrong", "more than 135 degrees"
    )
    opposite_slow: float = decided(
        0.35, "1", "cosine at the slow tenth of the frequencies from which the sign is right", CASES
    )
    like_no_valve: float = decided(
        0.65, "ln", "distance of the transfer from any valve's beyond which it is that of none", CASES
    )
    # Verdict ---------------------------------------------------------------------------------------------
    explains_nothing: float = decided(
        0.8, "1", "error from which a model explains nothing and units or columns are asked about", CASES
    )


#: Thresholds that the analysis uses.
THRESHOLDS = Thresholds()


def described() -> Mapping[str, tuple[float, str, str, str]]:
    """Return value, unit, what it decides and origin of each threshold, by name."""
    return {
        entry.name: (
            getattr(THRESHOLDS, entry.name),
            entry.metadata["unit"],
            entry.metadata["decides"],
            entry.metadata["origin"],
        )
        for entry in fields(Thresholds)
    }


def table() -> str:
    """Return the thresholds as a table in Markdown."""
    rows = [
        f"| `{name}` | {value:g} | {unit} | {decides} | {origin} |"
        for name, (value, unit, decides, origin) in described().items()
    ]
    return "\n".join(["| threshold | value | unit | decides | origin |", "|---|---|---|---|---|", *rows])


if __name__ == "__main__":
    print(table())
