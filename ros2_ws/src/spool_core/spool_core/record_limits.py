"""Limits by which records are judged: rate, length, noise, coherence, units; one table for all commands.

A rate is a number of samples in a period, of the valve's natural frequency or of the highest frequency
excited. Two samples in a period are the sampling theorem's limit; each analysis needs more, for its reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

#: Origin that several limits share. Blind cases are records of ``spool_blind``; those of the tables in the
#: documentation have other seeds than those that limits were chosen on.
CASES = "chosen on blind cases other than the published ones; not derived"


def decided(value: float, unit: str, decides: str, origin: str) -> Any:
    """Return a field of default ``value`` that carries its ``unit``, what it decides, and its origin."""
    return field(default=value, metadata={"unit": unit, "decides": decides, "origin": origin})


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the judgement of a record; ``limits_table`` shows each one's unit, use and origin."""

    # Rate
    slowest_valve: float = decided(
        5.0,
        "Hz",
        "natural frequency that a record must show",
        "a third of the softest valve's described here",
    )
    samples_of_estimate: float = decided(
        4.0, "1", "samples in a period of the natural frequency: estimate", "two, and a filter's octave above"
    )
    samples_of_gap: float = decided(
        25.0, "1", "the same of `gap`, which locates contacts and steps of friction within a period", CASES
    )
    samples_of_gap_excited: float = decided(
        3.0, "1", "samples in a period of the highest frequency excited: `gap`", "two, and room for a filter"
    )
    samples_of_shape: float = decided(
        8.0, "1", "the same for narrow intervals", "the third harmonic of a step of friction is seen"
    )
    # Length
    seconds_of_estimate: float = decided(
        2.0, "s", "stretch that an estimate needs", "the filters settle, and something is fitted"
    )
    stretch_of_gap: float = decided(
        4.0, "s", "stretch without gaps that `gap` uses", "one window, which settles first"
    )
    seconds_of_gap: float = decided(
        6.0, "s", "such stretches together that `gap` needs", "windows to fit and to hold out"
    )
    seconds_of_shape: float = decided(
        20.0, "s", "such stretches together for narrow intervals", "20 periods of 1 Hz, the slowest in use"
    )
    # Channels
    still: float = decided(
        0.5, "s", "time without any change from which a channel is dead", "noise changes a few samples on"
    )
    stands_out: float = decided(
        10.0, "1", "line over a spectrum's median from which a fit sees motion", "noise itself stays below 6"
    )
    excited: float = decided(
        5.0, "1", "rms over the noise's below which `gap` does not see what a model lacks", CASES
    )
    clipped: float = decided(
        0.005, "1", "share of samples on a flat top: clipping", "time of a sine in its outer 0.01 %"
    )
    coherent: float = decided(
        0.5, "1", "squared coherence of a line: spool follows body", "chance, 5 lines in 20 pieces: 1e-9"
    )
    incoherent: float = decided(
        0.3, "1", "coherent share of the spool's power: less, unrelated", "three times what chance gives"
    )
    # Units and signs
    unlike_described: float = decided(
        0.3, "ln", "distance of the transfer from the described valve's from which units are doubted", CASES
    )
    wrong_unit: float = decided(
        0.6, "1", "share of that distance that may remain if a factor of 9.81 is the cause", CASES
    )
    wrong_unit_everywhere: float = decided(
        0.85, "1", "the same share if the factor reduces the distance for every spring", CASES
    )
    carried: float = decided(
        0.95,
        "1",
        "coherence below which friction may carry a spool that is driven above its resonance",
        "a relay of noise has 2/pi; 0.80 to 0.87 in simulations with 0.2 to 1 N, 1 without friction",
    )
    opposite: float = decided(
        -0.7, "1", "cosine to the expected transfer below which a sign is wrong", "more than 135 degrees"
    )
    opposite_slow: float = decided(
        0.35, "1", "cosine at the slow tenth of the frequencies from which the sign is right", CASES
    )
    like_no_valve: float = decided(
        0.65, "ln", "distance of the transfer from any valve's beyond which no valve fits", CASES
    )
    # Verdict
    stuck: float = decided(
        0.05, "1", "motion over the described valve's, rms: less, stuck", "26 dB: springs 20 times as stiff"
    )
    explains_nothing: float = decided(
        0.8, "1", "error from which a model explains nothing and units or columns are asked for", CASES
    )

    @property
    def rate(self) -> float:
        """Hz below which nothing can be estimated of any valve; such streams, bags and files are refused."""
        return self.samples_of_estimate * self.slowest_valve


#: Limits that every command uses.
LIMITS = Limits()


def limits_table() -> str:
    """Return the limits as a table in Markdown."""
    rows = [
        f"| `{one.name}` | {getattr(LIMITS, one.name):g} | {' | '.join(one.metadata.values())} |"
        for one in fields(Limits)
    ]
    return "\n".join(["| limit | value | unit | decides | origin |", "|---|---|---|---|---|", *rows])


if __name__ == "__main__":
    print(limits_table())
