"""Laws as text: what documents and reports print is the force that is computed.

The text of a law is an equation of z, its derivative z' and the time t; its other symbols stand for the
parameters, in any order. A text is right where some assignment of symbols to parameters gives the forces.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from spool_sim.terms import TERMS, Term


def sign(number: float) -> float:
    return math.copysign(1.0, number) if number else 0.0


#: Groups of symbols that one parameter stands for.
GROUPS = {"(mu A_t / h)": "(K)", "(mu / h)": "(K)"}
FUNCTIONS: dict[str, Callable[..., float]] = {
    "exp": math.exp, "abs": abs, "sqrt": math.sqrt, "min": min, "max": max, "sin": math.sin, "cos": math.cos,
    "tanh": math.tanh, "arctan": math.atan, "log": math.log, "sgn": sign, "Sgn": sign,
}  # fmt: skip
_TOKEN = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?|[A-Za-z]\w*(?:,k)?'?|[-+*/^()\[\],<>]")
#: Laws without an equation of z, z' and t: of the acceleration, and by its derivative (below).
OTHERS = {"inertia", "play_friction", "presliding_friction"}


def python_of(text: str) -> tuple[str, set[str]]:
    """Return an equation as an expression of Python, and its names; symbols side by side are multiplied."""
    for group, name in GROUPS.items():
        text = text.replace(group, name)
    tokens = _TOKEN.findall(text)
    assert "".join(tokens) == text.replace(" ", ""), text
    parts: list[str] = []
    for before, token in zip([None, *tokens], tokens, strict=False):
        operand = before is not None and (before[-1].isalnum() or before[-1] in ")]'")
        called = before in FUNCTIONS
        if operand and not called and (token[0].isalnum() or token in "(["):
            parts.append("*")
        parts.append({"^": "**", "[": "(", "]": ")"}.get(token, token))
    words = [re.sub(r"'$", "_dot", re.sub(",k$", "_k", part)) for part in parts]
    return "".join(words), {one for one in words if re.fullmatch(r"[A-Za-z]\w*", one)}


def parts_of(text: str) -> list[str]:
    """Return what commas outside of brackets separate."""
    depths = itertools.accumulate((one in "([") - (one in ")]") for one in text)
    cuts = [at for at, depth in enumerate(depths) if depth == 0 and text[at : at + 2] == ", "]
    return [text[a:b].strip(", ") for a, b in itertools.pairwise([0, *cuts, len(text)])]


def pieces(law: str) -> tuple[list[tuple[str, str]], dict[str, str]]:
    """Return the expressions of a law with their conditions, and its definitions of what depends on z."""
    first, *rest = parts_of(law.removeprefix("F = ").partition(": ")[0])
    defined = {}
    for one in rest:
        match = re.fullmatch(r"(\w+) = (.*)", one)
        if match and re.search(r"\bz\b", match[2]):
            defined[match[1]] = match[2]
    cases = [one.partition(" for ") for one in (first, *(one for one in rest if " for " in one))]
    return [(text, when) for text, _, when in cases], defined


def forces(law: str, symbols: dict[str, float], motion: dict[str, float]) -> float:
    """Return the force (N) by the text of a law."""
    cases, defined = pieces(law)
    names: dict[str, Any] = {**FUNCTIONS, "pi": math.pi, **motion, **symbols}
    for name, text in defined.items():
        value, _, bound = text.partition(" > ")
        names[name] = evaluated(value, names)
        names[f"{name}_dot"] = sign(motion["z"]) * motion["z_dot"]
        if bound and names[name] <= float(bound):
            return 0.0
    return next((evaluated(text, names) for text, when in cases if not when or evaluated(when, names)), 0.0)


def evaluated(text: str, names: dict[str, Any]) -> float:
    return float(eval(python_of(text)[0], {"__builtins__": {}}, names))


def symbols_of(law: str, parameters: int) -> list[str]:
    """Return the symbols of a law that stand for its parameters."""
    cases, defined = pieces(law)
    texts = [text for case in cases for text in case if text]
    texts += [text.partition(" > ")[0] for text in defined.values()]
    known = {*FUNCTIONS, "pi", "z", "z_dot", "t", *defined, *(f"{one}_dot" for one in defined)}
    every = set().union(*(python_of(text)[1] for text in texts))
    # The paper writes an exponent as t; a law of time has one symbol fewer than names.
    return sorted(every - known | ({"t"} & every if len(every - known) < parameters else set()))


def agrees(law: str, entry: Term) -> bool:
    """Return whether the text gives the forces of ``entry`` for some assignment of its symbols."""
    rng = np.random.default_rng(11)
    names = [parameter.name for parameter in entry.parameters]
    symbols = symbols_of(law, len(names))
    if len(symbols) != len(names):
        return False
    points = []
    for z, v, t in rng.uniform((-5e-3, -0.3, 0.0), (5e-3, 0.3, 60.0), (30, 3)).tolist():
        values = {
            one.name: one.check(min(one.high, max(one.low, (one.start or min(1.0, one.high)) * size)))
            for one, size in zip(entry.parameters, rng.uniform(0.4, 1.6, len(names)).tolist(), strict=True)
        }
        one = np.ones(1)
        points.append((values, z, v, t, float(entry.force(z * one, v * one, 0.0 * one, values, t * one)[0])))

    def fits(order: tuple[str, ...]) -> bool:
        for values, z, v, t, force in points:
            motion = {"z": z, "z_dot": v, "t": t}
            given = {symbol: values[name] for symbol, name in zip(symbols, order, strict=True)}
            try:
                by_text = forces(law, given, motion)
            except (ArithmeticError, ValueError, TypeError):
                return False
            if not math.isclose(by_text, force, rel_tol=1e-6, abs_tol=1e-12):
                return False
        return True

    return any(fits(order) for order in itertools.permutations(names))


def wrong(law: str) -> Iterator[str]:
    """Yield texts with one mistake each."""
    for before, after in (("z'", "z"), (" + ", " - "), ("exp(-", "exp("), ("^2", "^3"), ("2 pi", "pi")):
        if before in law:
            yield law.replace(before, after, 1)
    yield law.replace("F = ", "F = 2 ", 1)


#: Symbols of which all orders are tried for texts that are wrong: eight would take minutes.
MOST = 6
LAWS = {name: entry for name, entry in TERMS.items() if name not in OTHERS}


@pytest.mark.parametrize("name", sorted(LAWS))
def test_the_law_as_text_is_the_force(name: str) -> None:
    """A text of another form fails, too: write it with z, z', t and one symbol a parameter."""
    entry = LAWS[name]
    law = entry.law
    match = re.fullmatch(r"abs\(F\) <= (.*) at rest, (.*) while slipping", law)
    if match is None:
        assert agrees(law, entry)
        return
    values = {one.name: one.start for one in entry.parameters}
    low, high = entry.at_rest(1e-3, values)
    symbols = symbols_of(f"F = {match[1]}", len(values))
    assert any(
        math.isclose(
            forces(
                f"F = {match[1]}", dict(zip(symbols, order, strict=True)), {"z": 1e-3, "z_dot": 0.0, "t": 0.0}
            ),
            high,
        )
        for order in itertools.permutations(values.values())
    )
    assert low == -high


@pytest.mark.parametrize(
    "name",
    sorted(name for name, one in LAWS.items() if one.law.startswith("F = ") and len(one.parameters) <= MOST),
)
def test_a_wrong_text_of_a_law_is_noticed(name: str) -> None:
    assert not [text for text in wrong(LAWS[name].law) if agrees(text, LAWS[name])]


def test_the_text_of_presliding_is_the_slope_of_its_force() -> None:
    entry = TERMS["presliding_friction"]
    law = entry.uncompiled("memory_law")
    assert law is not None
    slope, names = python_of(entry.law.partition("= ")[2])
    assert names - {"z_dot", "sgn"} == {"sigma_0", "F", "F_c"}
    for force, direction, largest, stiffness in ((0.1, 1.0, 0.5, 2e4), (-0.2, -1.0, 0.4, 3e4)):
        slip = direction * 1e-9
        found = (law(force, slip, direction, largest, stiffness) - force) / slip
        held = {"F": force, "F_c": largest, "sigma_0": stiffness, "z_dot": direction, "sgn": sign}
        assert found == pytest.approx(float(eval(slope, {}, held)), rel=1e-3)
