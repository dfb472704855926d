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

from spool_sim.terms import Parameter, Term, term

#: Module whose laws the stepping kernel imports, to be replaced by those of the terms.
_LAWS = "spool_sim.integration.fluid_laws"
_MEMORY = "memory_law"


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
    places = {parameter.name: place for place, parameter in enumerate(unique_parameters(terms))}
    imports = ["from spool_core.numbers import Array", ""]

    def calls(law: str) -> list[tuple[str, str]]:
        """Return the function and the parameters that a call of it ends with, of each term with the law."""
        found = []
        for number, entry in enumerate(terms):
            if law in entry.laws:
                name = f"{law}_{number}"
                line = f"from {entry.laws[law].__module__} import {law} as {name}"
                if line not in imports:
                    imports.append(line)
                found.append((name, "".join(f", q[{places[p.name]}]" for p in entry.parameters)))
        return found

    def added(parts: list[str]) -> str:
        return " + ".join(parts) or "0.0"

    memories = calls(_MEMORY)
    width = max(1, len(memories))
    forces = [f"{name}(z, v, t{ends})" for name, ends in calls("force_law")]
    forces += [f"x[{place}]" for place in range(len(memories))]
    sliding = calls("sliding_law")
    rests = dict(calls("rest_law"))
    slips = [f"{name}(z, speed, s{ends})" for name, ends in sliding]
    lows: list[str] = []
    highs: list[str] = []
    rest_lines: list[str] = []
    for name, ends in sliding:
        number = name.rpartition("_")[2]
        own = f"rest_law_{number}"
        if own in rests:
            rest_lines.append(f"low_{number}, high_{number} = {own}(z{ends})")
            lows.append(f"low_{number}")
            highs.append(f"high_{number}")
        else:
            lows.append(f"-{name}(z, 0.0, -1.0{ends})")
            highs.append(f"{name}(z, 0.0, 1.0{ends})")
    levels = calls("levels_law")
    level_lines = []
    for name, ends in levels:
        level_lines += [
            f"for place in {name}({ends[2:]}):",
            "    if low < place < high and (math.isnan(level) or (place < level) != (z1 < z0)):",
            "        level = place",
        ]
    mass = places["mass"]
    moved = [f"{name}(x[{place}], slip, s{ends})" for place, (name, ends) in enumerate(memories)] or ["x[0]"]
    events = bool(sliding or memories or levels)
    numbers = "tuple[float, ...]"
    functions = [
        ("given(parameters: Array, row: int) -> " + numbers, "the parameters that hold in ``row``",
         [f"return ({_tuple(f'parameters[row, {place}]' for place in places.values())})"]),
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
         [f"return ({_tuple(moved)})"]),
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
    found = next((node for node in imports if node.module == _LAWS), None)
    if found is None:
        raise RuntimeError(f"spool_sim.integration.stepping imports nothing from {_LAWS}")
    lines = text.splitlines(keepends=True)
    return "".join([*lines[: found.lineno - 1], laws, "\n\n", *lines[found.end_lineno :]])


@lru_cache(maxsize=256)
def kernel_of(names: tuple[str, ...]) -> ModuleType:
    """Return the kernel module of the terms called ``names``, in this order.

    It is compiled at its first call; later processes find it on the disk.
    """
    return load_kernel(kernel_source([term(name) for name in names]))


def load_kernel(source: str) -> ModuleType:
    """Return the kernel module of ``source``, which its name is a hash of."""
    name = f"spool_kernel_{hashlib.sha256(source.encode()).hexdigest()[:20]}"
    module = ModuleType(name)
    sys.modules[name] = module
    exec(compile(source, f"<{name}>", "exec"), module.__dict__)
    return module
