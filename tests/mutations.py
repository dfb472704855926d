"""How a line of code can be wrong: a function with one change each, as a typing error would make it."""

from __future__ import annotations

import ast
import copy
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

#: Functions that only convert or make room: dropping them changes no number.
NO_ARITHMETIC = {
    "float", "int", "asarray", "array", "zeros", "empty", "ones", "full", "len", "range", "zip", "astype",
    "enumerate", "concatenate", "tolist", "list", "isfinite",
}  # fmt: skip
ROOM = {"zeros", "empty", "ones"}
#: Constants up to this size guard against rounding.
GUARD = 1e-6


def _number(node: ast.expr, value: float) -> ast.expr:
    return ast.copy_location(ast.Constant(value), node)


def _call(node: ast.expr, operator: ast.operator, value: float) -> ast.expr:
    return ast.copy_location(ast.BinOp(node, operator, ast.Constant(value)), node)


def _of_operation(node: ast.BinOp) -> Iterator[ast.expr]:
    """Yield each operand alone, other operators, and other exponents."""
    if _guards(node.left) or _guards(node.right):
        return
    yield node.left
    yield node.right
    others: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
        ast.Add: (ast.Sub,),
        ast.Sub: (ast.Add,),
        ast.Mult: (ast.Div,),
        ast.Div: (ast.Mult,),
        ast.Pow: (ast.Mult,),
    }
    for other in others.get(type(node.op), ()):
        yield ast.BinOp(node.left, other(), node.right)
    if isinstance(node.op, ast.Pow):
        yield ast.BinOp(node.left, ast.Pow(), _call(node.right, ast.Add(), 1.0))
        yield ast.BinOp(node.left, ast.Pow(), _call(node.right, ast.Sub(), 0.5))


def _guards(node: ast.expr) -> bool:
    """Whether it is a constant so small that it only guards against rounding."""
    number = node.value if isinstance(node, ast.Constant) else None
    return isinstance(number, float) and 0.0 < number <= GUARD


def _name_of(node: ast.AST) -> str:
    """Return the name of the function that is called."""
    function = node.func if isinstance(node, ast.Call) else None
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _of_call(node: ast.Call) -> Iterator[ast.expr]:
    """Yield each argument alone, and the function's opposite."""
    name = _name_of(node)
    if name in NO_ARITHMETIC or any(map(_guards, node.args)):
        return
    for argument in node.args:
        if not isinstance(argument, ast.Starred):
            yield argument
    opposite = {
        "min": "max", "max": "min", "sin": "cos", "cos": "sin", "minimum": "maximum", "maximum": "minimum",
        "floor": "ceil", "ceil": "floor", "arctan2": "hypot", "hypot": "arctan2",
    }.get(name)  # fmt: skip
    if opposite:
        function = copy.deepcopy(node.func)
        if isinstance(function, ast.Attribute):
            function.attr = opposite
        elif isinstance(function, ast.Name):
            function.id = opposite
        yield ast.Call(function, node.args, node.keywords)


def _of_constant(node: ast.Constant) -> Iterator[ast.expr]:
    if isinstance(node.value, bool) or not isinstance(node.value, (int, float)) or _guards(node):
        return
    if isinstance(node.value, int):
        yield _number(node, node.value + 1)
    else:
        yield _number(node, 0.9 * node.value if node.value else 0.1)
        if node.value:
            yield _number(node, -node.value)


def _of_comparison(node: ast.Compare) -> Iterator[ast.expr]:
    opposite: dict[type[ast.cmpop], type[ast.cmpop]] = {
        ast.Lt: ast.Gt,
        ast.LtE: ast.Gt,
        ast.Gt: ast.Lt,
        ast.GtE: ast.Lt,
        ast.Eq: ast.NotEq,
        ast.NotEq: ast.Eq,
        ast.Is: ast.IsNot,
        ast.IsNot: ast.Is,
    }
    other = opposite.get(type(node.ops[0]))
    if other is not None and len(node.ops) == 1:
        yield ast.Compare(node.left, [other()], node.comparators)


def _others(node: ast.expr, parameters: list[str]) -> Iterator[ast.expr]:
    """Yield what may stand in place of one expression of a law."""
    if isinstance(node, ast.BinOp):
        yield from _of_operation(node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield node.operand
    elif isinstance(node, ast.Call):
        yield from _of_call(node)
    elif isinstance(node, ast.Constant):
        yield from _of_constant(node)
    elif isinstance(node, ast.Compare):
        yield from _of_comparison(node)
    elif isinstance(node, ast.IfExp):
        yield node.body
        yield node.orelse
    elif isinstance(node, ast.Name) and node.id in parameters:
        yield from (ast.Name(other, ast.Load()) for other in parameters if other != node.id)


def changed(function: ast.FunctionDef) -> Iterator[ast.FunctionDef]:
    """Yield the function with one change each."""
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    parameters = [argument.arg for argument in named if argument.arg not in ("self", "cls")]
    refusals = {id(part) for node in ast.walk(function) for part in refusal(node)}
    for number, node in enumerate(ast.walk(function)):
        if id(node) in refusals:
            continue
        for field, other in _of_statement(node):
            yield replaced(function, number, field, None, other)
        if isinstance(node, (ast.arguments, ast.AnnAssign, ast.Subscript)) or is_text(node):
            continue
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list", "args", "func", "slice") and not (
                field == "args" and isinstance(node, ast.Call)
            ):
                continue
            for place, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.expr):
                    for other in _others(child, parameters):
                        yield replaced(function, number, field, place, other)


def refusal(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of an error, of the guard before it, and of what only makes room."""
    if isinstance(node, ast.Raise) or _name_of(node) in ROOM:
        yield from ast.walk(node)
    elif isinstance(node, ast.If) and isinstance(node.body[-1], ast.Raise):
        yield node
        yield from ast.walk(node.test)


def _of_statement(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield another result, condition or operator of a statement, by its field."""
    if isinstance(node, ast.Return) and node.value is not None:
        yield from (("value", scaled) for scaled in _results(node.value))
    elif isinstance(node, ast.If):
        yield from (("test", ast.Constant(truth)) for truth in (True, False))
    elif isinstance(node, ast.AugAssign):
        opposite = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
        if type(node.op) in opposite:
            yield "op", opposite[type(node.op)]()


def _results(value: ast.expr) -> Iterator[ast.expr]:
    """Yield a result 10 % smaller, and with the other sign; of a tuple each of its numbers."""
    if isinstance(value, ast.Tuple):
        for place, element in enumerate(value.elts):
            for scaled in _results(element):
                yield ast.Tuple([*value.elts[:place], scaled, *value.elts[place + 1 :]], ast.Load())
        return
    nothing = isinstance(value, ast.Constant) and value.value == 0.0
    if nothing or _name_of(value) in ROOM:
        return
    for factor in (0.9, -1.0):
        yield ast.BinOp(ast.Constant(factor), ast.Mult(), value)


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def replaced(
    function: ast.FunctionDef, number: int, field: str, place: int | None, other: Any
) -> ast.FunctionDef:
    """Return the function with ``other`` in a field of its ``number``-th node."""
    changed = copy.deepcopy(function)
    node = next(itertools.islice(ast.walk(changed), number, None))
    if place is None:
        setattr(node, field, copy.deepcopy(other))
    else:
        getattr(node, field)[place] = copy.deepcopy(other)
    return ast.fix_missing_locations(changed)


def difference(before: str, after: str) -> tuple[str, str]:
    """Return the line that differs, before and after."""
    pairs = itertools.zip_longest(before.splitlines(), after.splitlines(), fillvalue="")
    one, other = next(pair for pair in pairs if pair[0] != pair[1])
    return one.strip(), other.strip()


def without_effect(listed: Path) -> dict[str, dict[str, str]]:
    """Return the reasons of the mutants that no test can notice, by place and by the line that they write."""
    found: dict[str, dict[str, str]] = {}
    for entry in yaml.safe_load(listed.read_text(encoding="utf-8")):
        found.setdefault(entry["where"], {}).update(dict.fromkeys(entry["lines"], entry["why"]))
    return found
