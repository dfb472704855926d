"""Thresholds: limits that the selection over two accelerometers compares with, each with its origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

#: Origins that several thresholds share. Blind cases are records of ``spool_blind``; those of the tables in
#: the documentation have other seeds than those that thresholds were chosen on.
CASES = "chosen on blind cases other than the published ones; not derived"
EFFORT = "bounds the work; chosen on blind cases other than the published ones"


def decided(value: float, unit: str, decides: str, origin: str) -> Any:
    """Return a field of default ``value`` that carries its ``unit``, what it decides, and its origin."""
    return field(default=value, metadata={"unit": unit, "decides": decides, "origin": origin})


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds of screening, selection and verdict; ``described`` tells each one's unit, use and origin.

    Evidence is twice the log likelihood ratio less the BIC penalty of the numbers that are fitted. Errors are
    rms(model - measured) / rms(measured), held out.
    """

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
        0.3, "1", "median coherence of both channels below which no verdict is trusted", CASES
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
    # Screening ------------------------------------------------------------------------------------------
    screened: float = decided(
        25.0, "1", "fall of the weighed squares in the regression from which an effect is simulated", CASES
    )
    screened_residual: float = decided(
        25.0, "1", "the same in what the free run leaves, jointly with accepted effects", CASES
    )
    screened_residual_alone: float = decided(
        5.0,
        "1",
        "the same where nothing is accepted yet",
        "lets small forces through, on which the simulation decides",
    )
    screened_small: float = decided(15.0, "1", "the same over all windows, for small effects", CASES)
    screened_clearly: float = decided(
        300.0, "1", "fall in the regression from which the free run of the base is not screened", EFFORT
    )
    screened_near: float = decided(
        0.25, "1", "share of the best candidate's fall that another one needs to be simulated", EFFORT
    )
    screened_confusable: float = decided(
        0.05, "1", "the same for an effect confusable with the best one", EFFORT
    )
    line: float = decided(
        4.0,
        "1",
        "amplitude of a spectral line over its neighbourhood, to be one",
        "noise has one line in 65,000 above 4 medians",
    )
    line_of_noise: float = decided(
        2.5,
        "1",
        "amplitude over its neighbourhood up to which the body's line is noise",
        "noise has one line in 76 above 2.5 medians",
    )
    # Selection ------------------------------------------------------------------------------------------
    evidence: float = decided(40.0, "1", "evidence that an effect needs on held-out windows", CASES)
    relative_gain: float = decided(
        4e-3, "1", "share of the weighed squares that an effect must take away", CASES
    )
    smallest: float = decided(
        5e-4,
        "1",
        "share of the measured acceleration, rms, that an effect must explain",
        "two right simulations differ by as much",
    )
    further_share: float = decided(
        0.08, "1", "share of the power left that a further effect must explain", CASES
    )
    further_open_share: float = decided(0.1, "1", "the same of the power that noise does not leave", CASES)
    most_helped: float = decided(
        0.15,
        "1",
        "share of the windows, the most helped, without which a further effect must still help",
        CASES,
    )
    at_noise_floor: float = decided(
        1.2, "1", "error over the noise floor up to which nothing is left: chance does not lead there", CASES
    )
    smooth_at_noise_floor: float = decided(
        1.08,
        "1",
        "the same where no force has kinks, which simulates without error",
        "the noise floor is known to some 5 %",
    )
    closed: float = decided(
        1.3, "1", "error over the noise floor up to which it is noise if it is not predictable", CASES
    )
    no_worse: float = decided(
        1.01, "1", "error over that with an effect up to which others do without it", CASES
    )
    richer_evidence: float = decided(
        16.0, "1", "evidence by which a richer law must beat a simpler one that it contains", CASES
    )
    by_chance: float = decided(
        0.005,
        "1",
        "probability by chance of its gains, window by window, up to which a richer law wins",
        "one false law in 200 comparisons (Wilcoxon's signed ranks)",
    )
    fewest_windows: float = decided(
        8,
        "1",
        "windows from which that test is made",
        "8 gains of one sign: chance of 1 / 256, below the threshold",
    )
    clearly: float = decided(
        0.03,
        "1",
        "share of the weighed squares that decides in fewer windows, and between confusable effects",
        CASES,
    )
    beyond_tolerance: float = decided(
        2.0, "1", "standard deviations by which gain or delay must exceed its tolerance", "95 % interval"
    )
    equivalent_cost: float = decided(
        10.0, "1", "cost over the best law's up to which another starts where it acts alike", EFFORT
    )
    hopeful_cost: float = decided(
        2.0, "1", "cost over the best one's up to which a law that contains it is fitted on", EFFORT
    )
    too_far: float = decided(
        1.3, "1", "cost over the other law's from which all windows are not asked", EFFORT
    )
    too_far_everywhere: float = decided(
        1.1, "1", "the same where it is behind in nearly all held-out windows", EFFORT
    )
    extreme_windows: float = decided(
        0.1, "1", "share of the windows on either end that do not count between laws by all windows", CASES
    )
    small_evidence: float = decided(
        5.0, "1", "evidence over all windows that a small effect needs", "a likelihood ratio of 12"
    )
    small_evidence_in_time: float = decided(
        20.0, "1", "the same for an effect that goes with the time, as small errors of any model do", CASES
    )
    two_forces_evidence: float = decided(
        25.0, "1", "evidence of the start from rest that two friction forces need over one", CASES
    )
    two_forces_deviations: float = decided(
        2.0, "1", "standard deviations by which their ratio must differ from 0", "95 % interval"
    )
    two_forces_ratio: float = decided(
        0.1, "1", "half their difference over their mean from which they are two", CASES
    )
    stop_gain: float = decided(
        0.01,
        "1",
        "gain of the spool's channel found free of contact from which hits are looked at again",
        CASES,
    )
    stop_delay: float = decided(0.2e-3, "s", "delay found so from which hits are looked at again", CASES)
    stop_halves: float = decided(
        0.5, "1", "share of the power left without a stop that one may leave to be judged by power", CASES
    )
    # Verdict --------------------------------------------------------------------------------------------
    predictable: float = decided(
        0.07,
        "1",
        "predictable share of the weighed residual from which a model is incomplete",
        "between what right models (below) and others (above) left in blind cases",
    )
    predictable_evidence: float = decided(40.0, "1", "evidence of that share", "as of an effect")
    predictable_smallest: float = decided(
        1e-3,
        "1",
        "its amplitude over the measured one from which it counts",
        "two right simulations differ by as much",
    )
    predictable_of_gap: float = decided(
        0.02,
        "1",
        "its amplitude over the gap's from which it counts",
        "two right simulations differ by as much",
    )
    predictable_of_gap_smooth: float = decided(
        5e-3, "1", "the same where no force has kinks", "two right simulations differ by as much"
    )
    residual_power: float = decided(
        1.8, "1", "residual power over the noise floor's from which something is left", CASES
    )
    may_stay: float = decided(
        0.05, "1", "share of the gap's amplitude that a complete model may leave", CASES
    )
    may_stay_smooth: float = decided(
        0.01, "1", "the same where no force has kinks", "nothing excuses what a smooth model leaves"
    )
    may_stay_with_stop: float = decided(
        0.5,
        "1",
        "the same with a stop: the motion is sensitive to hits",
        "the right numbers leave a third of the median window",
    )
    above_noise_floor: float = decided(
        1.1,
        "1",
        "error over the noise floor up to which it may be noise",
        "the noise floor is known to some 5 %",
    )
    hardly_closed: float = decided(
        0.7,
        "1",
        "share of the gap's amplitude beyond which a free run does not show what is named",
        "none of 970 blind cases that was named right left more than 0.51",
    )
    jitter_evidence: float = decided(60.0, "1", "evidence from which sampling instants scatter", CASES)
    jitter_share: float = decided(
        0.2, "1", "share of the noise above the excitation that must grow with the slope for that", CASES
    )
    explains_nothing: float = decided(
        0.8, "1", "error from which a model explains nothing and units or columns are asked about", CASES
    )


#: Thresholds that the workflow decides by.
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
