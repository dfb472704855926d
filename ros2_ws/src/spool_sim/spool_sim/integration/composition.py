"""Kernel generation from the laws of the terms of a model; compiled once per machine."""

from __future__ import annotations

import ast
import hashlib
import importlib
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType

from spool_core.errors import InputError

from spool_sim.terms import Parameter, Term

#: Module whose laws the stepping kernel imports, to be replaced by those of the terms.
_REPLACED = "spool_sim.integration.fluid_laws"


def unique_parameters(terms: Sequence[Term]) -> tuple[Parameter, ...]:
    """Return the parameters of ``terms``; what two terms share, with the same meaning, stands once.

    Raises:
        InputError: two terms use one name for different things.
    """
    found: dict[str, tuple[Parameter, str]] = {}
    for entry in terms:
        for parameter in entry.parameters:
            known = found.setdefault(parameter.name, (parameter, entry.name))
            if known[0] != parameter:
                raise InputError(
                    f"terms: '{known[1]}' and '{entry.name}' both have a {parameter.name}; "
                    f"keep one of the two terms"
                )
    return tuple(parameter for parameter, _ in found.values())


@dataclass(frozen=True, slots=True)
class Switches:
    """Columns of a parameter set for a kernel whose terms can be switched off, at a comparison for each.

    Attributes:
        columns: place of each term's parameter, by (term, parameter).
        terms: place of each term's switch, which is 0 for off; a term without one is always on.
        pushing: place of the common switch of all terms that do more than slide and hold at rest.
    """

    columns: Mapping[tuple[str, str], int]
    terms: Mapping[str, int]
    pushing: int

    @classmethod
    def of(cls, terms: Sequence[Term], always: Sequence[str]) -> Switches:
        """Return the columns for ``terms``; those called ``always`` have no switch."""
        shared = list(dict.fromkeys(one for entry in terms for one in entry.parameters))
        columns = {(entry.name, one.name): shared.index(one) for entry in terms for one in entry.parameters}
        switched = [entry.name for entry in terms if entry.name not in always]
        places = {name: len(shared) + place for place, name in enumerate(switched)}
        return cls(columns, places, len(shared) + len(switched))


class _Writer:
    """Writes what all laws have in common: calls with the right columns, and switches."""

    def __init__(self, terms: Sequence[Term], switches: Switches | None) -> None:
        self.terms, self.switches = terms, switches
        if switches is None:
            shared = {one.name: place for place, one in enumerate(unique_parameters(terms))}
            self.columns: Mapping[tuple[str, str], int] = {
                (entry.name, one.name): shared[one.name] for entry in terms for one in entry.parameters
            }
            self.given = f"({_tuple(f'parameters[row, {place}]' for place in shared.values())})"
            self.read, self.numbers, self.innermost = "q[{}]", "tuple[float, ...]", "inner"
        else:
            self.columns, self.given = switches.columns, "parameters[row]"
            # A record goes to a function as its address; dozens of numbers by value cost more than the laws.
            self.read, self.numbers, self.innermost = "q.c{}", "np.void", "inlined"

    def having(self, law: str) -> list[int]:
        return [number for number, entry in enumerate(self.terms) if law in entry.laws]

    def call(self, law: str, number: int, *motion: str) -> str:
        entry = self.terms[number]
        own = {one.name: self.read.format(self.columns[entry.name, one.name]) for one in entry.parameters}
        return entry.call(number, own, law, *motion)

    def switch(self, number: int) -> str | None:
        """Return the test whether a term is on, ``None`` where it always is."""
        place = self.switches.terms.get(self.terms[number].name) if self.switches else None
        return None if place is None else f"q.c{place} != 0.0"

    def guarded(self, number: int, *lines: str) -> list[str]:
        test = self.switch(number)
        return list(lines) if test is None else _within(f"if {test}:", lines)

    def added(self, parts: Sequence[tuple[int, str]], common: str = "") -> list[str]:
        """Return the lines that return the sum of the forces of the terms that are on."""
        always = " + ".join(force for number, force in parts if self.switch(number) is None) or "0.0"
        switched = [(number, f"total += {force}") for number, force in parts if self.switch(number)]
        lines = [line for number, force in switched for line in self.guarded(number, force)]
        if not lines:
            return [f"return {always}"]
        return [f"total = {always}", *(_within(common, lines) if common else lines), "return total"]


def laws_source(terms: Sequence[Term], switches: Switches | None = None) -> str:
    """Return the Python source of the laws of ``terms`` together, as ``stepping`` takes it.

    Without ``switches`` all terms are on, and share parameters by name.
    """
    writer = _Writer(terms, switches)
    call, guarded, switch = writer.call, writer.guarded, writer.switch
    memories, sliding, levels = (writer.having(law) for law in ("memory_law", "sliding_law", "levels_law"))
    forces = [(number, call("force_law", number, "z", "v", "t")) for number in writer.having("force_law")]
    forces += [(number, f"x[{place}]") for place, number in enumerate(memories)]
    slips = [(number, call("sliding_law", number, "z", "speed", "s")) for number in sliding]
    rests: list[str] = []
    for number in sliding:
        if "rest_law" in terms[number].laws:
            held = call("rest_law", number, "z")
            lines = [
                f"low_{number}, high_{number} = {held}",
                f"low += low_{number}",
                f"high += high_{number}",
            ]
        else:
            low, high = (call("sliding_law", number, "z", "0.0", side) for side in ("-1.0", "1.0"))
            lines = [f"low -= {low}", f"high += {high}"]
        rests += guarded(number, *lines)
    kinks = ["level = math.nan", "low, high = min(z0, z1), max(z0, z1)"] if levels else []
    for number in levels:
        kinks += guarded(
            number,
            f"for place in {call('levels_law', number)}:",
            "    if low < place < high and (math.isnan(level) or (place < level) != (z1 < z0)):",
            "        level = place",
        )
    pushing = f"q.c{switches.pushing}" if switches else ""
    if pushing and levels:
        kinks = [f"if {pushing} == 0.0:", "    return math.nan", *kinks]
    moved = []
    for place, number in enumerate(memories):
        force, test = call("memory_law", number, f"x[{place}]", "slip", "s"), switch(number)
        moved.append(force if test is None else f"({force} if {test} else 0.0)")
    numbers, kind, innermost = "tuple[float, ...]", writer.numbers, writer.innermost
    starts = _tuple(f"state[{3 + place}]" for place in range(max(1, len(memories))))
    functions = [
        ("inner", f"given(parameters: Array, row: int) -> {kind}", "the parameters that hold in ``row``",
         [f"return {writer.given}"]),
        ("inner", f"start_memory(state: Array) -> {numbers}", "the forces that the terms remember, N",
         [f"return ({starts})"]),
        (innermost, f"smooth(z: float, v: float, t: float, x: {numbers}, q: {kind}) -> float",
         "the sum of the forces that are continuous in the motion, N",
         writer.added(forces, f"if {pushing} != 0.0:" if pushing else "")),
        (innermost, f"sliding(z: float, speed: float, s: float, q: {kind}) -> float",
         "the sum of dry friction while slipping, N", writer.added(slips)),
        ("inner", f"rest(z: float, q: {kind}) -> tuple[float, float]",
         "what dry friction can take up at rest, N",
         ["low, high = 0.0, 0.0", *rests, "return low, high"]),
        (innermost, f"remembered(x: {numbers}, slip: float, s: float, q: {kind}) -> {numbers}",
         "the forces that the terms remember after slipping on by ``slip`` m, N",
         [f"return ({_tuple(moved or ['x[0]'])})"]),
        ("inner", f"next_level(z0: float, z1: float, q: {kind}) -> float",
         "the first kink between z0 and z1, m, or not a number",
         [*kinks, f"return {'level' if levels else 'math.nan'}"]),
    ]  # fmt: skip
    mass = writer.columns["inertia", "mass"]
    text = ["import numpy as np"] if switches else []
    text += ["from spool_core.numbers import Array", ""]
    text += sorted(
        entry.imported(number, law)
        for number, entry in enumerate(terms)
        for law in entry.laws
        if law != "inertia_law"
    )
    text += ["", f"EVENTS = {bool(sliding or memories or levels)}"]
    text += [f"MASS = {mass if switches is None else repr(f'c{mass}')}"]
    for decorator, head, returns, body in functions:
        text += ["", "", f"@{decorator}", f"def {head}:", f'    """Return {returns}."""']
        text += [f"    {line}" for line in body]
    return "\n".join(text) + "\n"


def _within(head: str, lines: Iterable[str]) -> list[str]:
    return [head, *(f"    {line}" for line in lines)]


def _tuple(parts: Iterable[str]) -> str:
    listed = list(parts)
    return ", ".join(listed) + ("," if len(listed) == 1 else "")


def kernel_source(terms: Sequence[Term], switches: Switches | None = None) -> str:
    """Return the source of the whole kernel module: the stepping with the laws of ``terms`` for its own."""
    text = Path(importlib.import_module("spool_sim.integration.stepping").__file__ or "").read_text("utf-8")
    imports = (node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom))
    found = next((node for node in imports if node.module == _REPLACED), None)
    if found is None:
        raise RuntimeError(f"spool_sim.integration.stepping imports nothing from {_REPLACED}")
    lines, laws = text.splitlines(keepends=True), laws_source(terms, switches)
    return "".join([*lines[: found.lineno - 1], laws, "\n\n", *lines[found.end_lineno :]])


@lru_cache(maxsize=256)
def kernel_of(terms: tuple[Term, ...]) -> ModuleType:
    """Return the kernel module of ``terms``, in this order.

    It is compiled at its first call; later processes find it on the disk.
    """
    return load_kernel(kernel_source(terms))


@lru_cache(maxsize=256)
def load_kernel(source: str) -> ModuleType:
    """Return the kernel module of ``source``, which its name is a hash of."""
    name = f"spool_kernel_{hashlib.sha256(source.encode()).hexdigest()[:20]}"
    module = ModuleType(name)
    sys.modules[name] = module
    exec(compile(source, f"<{name}>", "exec"), module.__dict__)
    return module
