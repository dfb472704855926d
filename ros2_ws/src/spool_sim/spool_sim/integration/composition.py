"""Kernel generation from the laws of the terms of a model; compiled once per machine."""

from __future__ import annotations

import ast
import hashlib
import importlib
import sys
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType

from spool_core.errors import InputError

from spool_sim.terms import Parameter, Term
from spool_sim.terms.base import LAWS

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


def laws_source(terms: Sequence[Term]) -> str:
    """Return the Python source of the laws of ``terms`` together, as ``stepping`` takes it."""
    places = {one.name: f"q[{place}]" for place, one in enumerate(unique_parameters(terms))}
    having = {law: [number for number, entry in enumerate(terms) if law in entry.laws] for law in LAWS}
    imports = ["from spool_core.numbers import Array", ""]
    imports += sorted(
        terms[number].imported(number, law)
        for law, numbers in having.items()
        for number in (numbers if law != "inertia_law" else ())
    )

    def call(law: str, number: int, *motion: str) -> str:
        return terms[number].call(number, places, law, *motion)

    def added(parts: list[str]) -> str:
        return " + ".join(parts) or "0.0"

    memories, sliding, levels = having["memory_law"], having["sliding_law"], having["levels_law"]
    width = max(1, len(memories))
    forces = [call("force_law", number, "z", "v", "t") for number in having["force_law"]]
    forces += [f"x[{place}]" for place in range(len(memories))]
    slips = [call("sliding_law", number, "z", "speed", "s") for number in sliding]
    lows: list[str] = []
    highs: list[str] = []
    rest_lines: list[str] = []
    for number in sliding:
        if number in having["rest_law"]:
            rest_lines.append(f"low_{number}, high_{number} = {call('rest_law', number, 'z')}")
            lows.append(f"low_{number}")
            highs.append(f"high_{number}")
        else:
            lows.append(f"-{call('sliding_law', number, 'z', '0.0', '-1.0')}")
            highs.append(call("sliding_law", number, "z", "0.0", "1.0"))
    level_lines = []
    for number in levels:
        level_lines += [
            f"for place in {call('levels_law', number)}:",
            "    if low < place < high and (math.isnan(level) or (place < level) != (z1 < z0)):",
            "        level = place",
        ]
    mass = list(places).index("mass")
    moved = [call("memory_law", number, f"x[{place}]", "slip", "s") for place, number in enumerate(memories)]
    events = bool(sliding or memories or levels)
    numbers = "tuple[float, ...]"
    functions = [
        ("given(parameters: Array, row: int) -> " + numbers, "the parameters that hold in ``row``",
         [f"return ({_tuple(f'parameters[row, {place}]' for place in range(len(places)))})"]),
        ("start_memory(state: Array) -> " + numbers, "the forces that the terms remember, N",
         [f"return ({_tuple(f'state[{3 + place}]' for place in range(width))})"]),
        (f"smooth(z: float, v: float, t: float, x: {numbers}, q: {numbers}) -> float",
         "the sum of the forces that are continuous in the motion, N", [f"return {added(forces)}"]),
        (f"sliding(z: float, speed: float, s: float, q: {numbers}) -> float",
         "the sum of dry friction while slipping, N", [f"return {added(slips)}"]),
        (f"rest(z: float, q: {numbers}) -> tuple[float, float]",
         "what dry friction can take up at rest, N",
         [*rest_lines, f"return {added(lows)}, {added(highs)}"]),
        (f"remembered(x: {numbers}, slip: float, s: float, q: {numbers}) -> {numbers}",
         "the forces that the terms remember after slipping on by ``slip`` m, N",
         [f"return ({_tuple(moved or ['x[0]'])})"]),
        (f"next_level(z0: float, z1: float, q: {numbers}) -> float",
         "the first kink between z0 and z1, m, or not a number",
         ["level = math.nan", "low, high = min(z0, z1), max(z0, z1)", *level_lines, "return level"]
         if levels else ["return math.nan"]),
    ]  # fmt: skip
    text = [*imports, "", f"EVENTS = {events}", f"MASS = {mass}"]
    for head, returns, body in functions:
        text += ["", "", "@inner", f"def {head}:", f'    """Return {returns}."""']
        text += [f"    {line}" for line in body]
    return "\n".join(text) + "\n"


def _tuple(parts: Iterable[str]) -> str:
    listed = list(parts)
    return ", ".join(listed) + ("," if len(listed) == 1 else "")


def kernel_source(terms: Sequence[Term]) -> str:
    """Return the source of the whole kernel module of ``terms``."""
    return kernel_with(laws_source(terms))


def kernel_with(laws: str) -> str:
    """Return the source of the stepping kernel with ``laws`` in place of those that it imports."""
    text = Path(importlib.import_module("spool_sim.integration.stepping").__file__ or "").read_text("utf-8")
    imports = (node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom))
    found = next((node for node in imports if node.module == _REPLACED), None)
    if found is None:
        raise RuntimeError(f"spool_sim.integration.stepping imports nothing from {_REPLACED}")
    lines = text.splitlines(keepends=True)
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
