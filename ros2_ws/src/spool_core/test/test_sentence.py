from __future__ import annotations

import math
import re
from decimal import Decimal

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from spool_core.text import Account, ShareOfCause, change, duration, over, raised

NUMBER = r"(-?[0-9.]+(?:e-?[0-9]+)?)"
SENTENCE = re.compile(
    rf"(?P<name>[\w ]+) (?:(?P<verb>rose|fell) by {NUMBER} ?(?P<by>[^ ]*.*) to|as before at) "
    rf"{NUMBER} ± {NUMBER}(?P<unit>.*), baseline {NUMBER} ± {NUMBER}(?P=unit) \(± 95 %\)"
)


def read(sentence: str) -> tuple[str, Decimal, str, list[Decimal]]:
    """Return what a change's sentence says: direction, size, its unit, and now ± and baseline ±."""
    found = SENTENCE.fullmatch(sentence)
    assert found is not None, sentence
    numbers = [found.group(place) for place in (3, 5, 6, 8, 9)]
    size, *four = [Decimal(one or 0) for one in numbers]
    return found["verb"] or "", size, (found["by"] or "").strip(), four


@given(
    baseline=st.floats(1e-4, 1e6),
    factor=st.floats(-20.0, 20.0),
    spread=st.floats(1e-5, 0.5),
    deviation=st.floats(1e-5, 0.5),
    relative=st.booleans(),
    unit=st.sampled_from(["N", "N s/m", "N/m", "1"]),
)
@example(baseline=0.1002, factor=3.4925, spread=0.03, deviation=0.02, relative=False, unit="N")
@example(baseline=8.2, factor=0.61, spread=0.005, deviation=0.01, relative=True, unit="N s/m")
@example(baseline=1.0, factor=1.0001, spread=0.1, deviation=0.1, relative=True, unit="N s/m")
def test_the_numbers_of_a_change_follow_from_each_other(
    baseline: float, factor: float, spread: float, deviation: float, relative: bool, unit: str
) -> None:
    text = change(
        "coulomb_force", unit, (factor * baseline, deviation * baseline), (baseline, spread * baseline),
        relative=relative,
    )  # fmt: skip
    verb, size, by, (now, half, before, half_before) = read(text)
    assert text.startswith("Coulomb force ")
    assert half > 0
    assert half_before > 0
    difference = now - before
    assert verb == ("rose" if difference > 0 else "fell" if difference < 0 else "")
    if not verb:
        return
    if relative and before:
        assert by == "%"
        exact = abs(100 * difference / before)
        digits = max(-1, exact.adjusted() - 1) if exact >= 1 else exact.adjusted()
        assert abs(size - exact) <= Decimal("0.5000001") * Decimal(1).scaleb(min(0, digits))
    else:
        assert by == ("" if unit == "1" else unit)
        assert size == abs(difference)


def test_a_change_says_numbers_that_a_reader_can_check() -> None:
    said = change("coulomb_force", "N", (0.3499, 0.0056), (0.1002, 0.0041), relative=False)
    assert said == ("Coulomb force rose by 0.250 N to 0.350 ± 0.011 N, baseline 0.100 ± 0.008 N (± 95 %)")
    said = change("viscous_coefficient", "N s/m", (4.99, 0.06), (8.2, 0.02), relative=True)
    assert said == (
        "viscous coefficient fell by 39 % to 4.99 ± 0.12 N s/m, baseline 8.20 ± 0.04 N s/m (± 95 %)"
    )
    unknown = change("coulomb_force", "N", (math.nan, math.nan), (0.1, 0.01), relative=False)
    assert unknown.startswith("Coulomb force unknown, baseline 0.1")


CAUSES = st.lists(
    st.tuples(
        st.sampled_from(["wear", "oil_contamination", "oil_viscosity", "unknown"]), st.floats(0.01, 9.0)
    ),
    max_size=4,
    unique_by=lambda cause: cause[0],
)


@given(
    scores=CAUSES,
    began=st.one_of(st.just(math.nan), st.floats(0.0, 1e6)),
    judgement=st.sampled_from(["", "j"]),
)
def test_a_sentence_keeps_its_order_and_says_nothing_twice(
    scores: list[tuple[str, float]], began: float, judgement: str
) -> None:
    total = sum(score for _, score in scores)
    ranked = sorted(scores, key=lambda one: -one[1])
    causes = tuple(ShareOfCause(name, score / total, "") for name, score in ranked)
    account = Account("force rose", judgement, began, causes)
    clauses = raised(account, "flush").split("; ")
    assert len(set(clauses)) == len(clauses)
    order = ["force rose", "began about", "most likely cause: ", "or ", "what to do: flush"]
    places = [
        next(place for place, start in enumerate(order) if clause.startswith(start)) for clause in clauses
    ]
    assert places == sorted(places)
    assert places[0] == 0
    assert places[-1] == 4
    shares = [Decimal(share) for share in re.findall(r"share ([0-9.]+)", raised(account))]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) <= Decimal("1.02")
    assert "%" not in raised(account)
    evident = tuple(ShareOfCause(cause.name, cause.share, "as the oil warmed") for cause in causes)
    told = raised(Account("force rose", causes=evident))
    assert told.count("as the oil warmed") == min(1, len([one for one in causes if one.share >= 0.1]))
    ended = over("friction_drift", account, 12.34)
    assert ended == "friction drift is over after 12.3 s: force rose"


@given(st.floats(0.0, 1e8))
def test_a_duration_is_right_to_the_digit_shown(seconds: float) -> None:
    number, unit = duration(seconds).split(" ")
    step, length = {"s": (0.1, 1.0), "min": (1.0, 60.0), "h": (1.0, 3600.0), "days": (1.0, 86400.0)}[unit]
    assert float(number) * length == pytest.approx(seconds, abs=0.5001 * step * length)
    assume(seconds > 0.1)
    assert float(number) > 0.0
