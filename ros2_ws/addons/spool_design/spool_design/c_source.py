"""C source of a model: the kernel's Python functions, translated statement by statement.

Laws and time step exist once, in Python: numba compiles them for the suite, this module writes them as C for
an FMU. It takes the part of Python that these functions use: numbers, tuples of numbers, ``math``, ``if``,
``for`` over ``range`` or a tuple, calls of each other. Everything else is refused by name.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from spool_core.errors import InputError
from spool_sim.integration.composition import kernel_source, unique_parameters
from spool_sim.terms import Term

#: Module of the kernel: its functions keep their names in C, those of others are named after their module.
_KERNEL = "spool_sim.integration.stepping"
#: Functions of the kernel that an FMU calls; all that these call comes with them.
ROOTS = (
    "acceleration", "slip", "step_of", "needed_at_rest", "piece", "step_with_events", "sliding", "rest",
    "drag",
)  # fmt: skip
#: Functions of ``math`` and built-in ones, by what C calls them.
_C_NAMES = {
    **{name: name for name in ("copysign", "sqrt", "exp", "expm1", "log", "log10", "log1p", "pow", "sin")},
    **{name: name for name in ("cos", "tan", "atan", "tanh", "sinh", "cosh", "floor", "ceil", "hypot")},
    "isnan": "isnan",
    "fabs": "fabs",
    "abs": "fabs",
    "min": "spool_min",
    "max": "spool_max",
}
_CONSTANTS = {"inf": "INFINITY", "nan": "NAN", "pi": repr(math.pi), "e": repr(math.e), "tau": repr(math.tau)}
_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.USub: "-", ast.UAdd: "+", ast.Not: "!",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.And: "&&", ast.Or: "||",
}  # fmt: skip
#: Words that are names in Python and something else in C.
_RESERVED = {
    "auto", "case", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto",
    "inline", "int", "long", "register", "restrict", "short", "signed", "sizeof", "static", "struct",
    "switch", "typedef", "union", "unsigned", "void", "volatile",
}  # fmt: skip
#: Tuples of five numbers in the kernel.
_FIVE = ("Step", "Start", "Bracket")
#: Tuple of as many numbers as the model has parameters, or terms that remember.
PARAMETERS, MEMORY = "const double *", "spool_memory"
_DOUBLE, _INT = "double", "int"

_HEAD = """\
#include <math.h>

static inline double spool_min(double a, double b) { return b < a ? b : a; }
static inline double spool_max(double a, double b) { return b > a ? b : a; }
"""


@dataclass(frozen=True, slots=True)
class _Source:
    """Function in Python: what it says, and the namespace its names belong to."""

    node: ast.FunctionDef
    functions: dict[str, ast.FunctionDef]
    imports: dict[str, tuple[str, str]]


@dataclass(slots=True)
class Translation:
    """C functions of a set of Python functions.

    Attributes:
        functions: definition of each, callees first.
        tuples: definition of each structure that one returns, by its name.
        returns: type that each returns, by its name in C.
    """

    functions: list[str] = field(default_factory=list)
    tuples: dict[str, str] = field(default_factory=dict)
    returns: dict[str, str] = field(default_factory=dict)
    _modules: dict[str, tuple[dict[str, ast.FunctionDef], dict[str, tuple[str, str]]]] = field(
        default_factory=dict
    )

    def add_law(self, module: str, law: str, name: str) -> None:
        """Add the function ``law`` of the Python ``module`` under ``name``.

        Raises:
            InputError: it uses something that has no translation.
        """
        functions, imports = self._module(module)
        if law not in functions:
            raise InputError(
                f"{module}.{law}: cannot be exported to C: it is no Python function of that module"
            )
        self.add(_Source(functions[law], functions, imports), name, module)

    def add(self, source: _Source, name: str, module: str) -> None:
        """Add one function and all that it calls."""
        if name not in self.returns:
            self.returns[name] = _annotated(source.node.returns, source.node.name, memory=True)
            _Function(self, source, name, module).write()

    def tuple_type(self, parts: Sequence[str]) -> str:
        """Return the structure of a tuple with ``parts``, defined at its first use."""
        name = "spool_" + "".join({_DOUBLE: "d", MEMORY: "m"}[part] for part in parts)
        fields = " ".join(f"{part} f{number};" for number, part in enumerate(parts))
        self.tuples.setdefault(name, f"typedef struct {{ {fields} }} {name};")
        return name

    def text(self, terms: Sequence[Term] = ()) -> str:
        """Return the source: structures, then the functions."""
        places = [parameter.name for parameter in unique_parameters(terms)]
        defined = {
            "MASS": places.index("mass") if places else 0,
            "EVENTS": int(any(entry.jumps or "levels_law" in entry.laws for entry in terms)),
            "MEMORIES": max(1, sum("memory_law" in entry.laws for entry in terms)),
        }
        head = _HEAD + "".join(f"#define {name} {value}\n" for name, value in defined.items())
        memory = f"typedef struct {{ double values[MEMORIES]; }} {MEMORY};"
        return "\n\n".join([head, "\n".join([memory, *self.tuples.values()]), *self.functions]) + "\n"

    def _module(self, name: str) -> tuple[dict[str, ast.FunctionDef], dict[str, tuple[str, str]]]:
        if name not in self._modules:
            try:
                text = inspect.getsource(importlib.import_module(name))
            except (OSError, TypeError):
                raise InputError(f"{name}: cannot be exported to C: it has no Python source") from None
            self._modules[name] = parsed(text)
        return self._modules[name]


def parsed(text: str) -> tuple[dict[str, ast.FunctionDef], dict[str, tuple[str, str]]]:
    """Return the functions of a module by name, and module and name that each imported name comes from."""
    functions, imports = {}, {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            functions[node.name] = node
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                imports[alias.asname or alias.name] = (node.module or "", alias.name)
    return functions, imports


def _annotated(node: ast.expr | None, where: str, *, memory: bool = False) -> str:
    """Return the C type of an annotation; a tuple of any length is memory or parameters."""
    text = "" if node is None else ast.unparse(node)
    found = {"float": _DOUBLE, "int": _INT, "bool": _INT, **dict.fromkeys(_FIVE, "spool_ddddd")}.get(text)
    if found is not None:
        return found
    if text in ("Numbers", "tuple[float, ...]"):
        return MEMORY if memory else PARAMETERS
    if text.startswith("tuple[") and text.endswith("]"):
        parts = [part.strip() for part in text[6:-1].split(",")]
        kinds = [{"float": _DOUBLE, "Numbers": MEMORY}.get(part) for part in parts]
        if None not in kinds:
            return "spool_" + "".join("m" if kind == MEMORY else "d" for kind in kinds)
    raise InputError(f"{where}: '{text}' cannot be exported to C: use float, or a tuple of float")


class _Function:
    """Translation of one function."""

    def __init__(self, all_of_it: Translation, source: _Source, name: str, module: str) -> None:
        self._all, self._source, self._name, self._module = all_of_it, source, name, module
        self._types: dict[str, str] = {}
        self._lines: list[str] = []
        self._depth = 1
        self._temporary = 0

    def write(self) -> None:
        """Append the definition to the translation; callees append theirs before."""
        node = self._source.node
        arguments = []
        for argument in node.args.args:
            kind = _annotated(argument.annotation, self._where(node), memory=argument.arg == "x")
            self._types[argument.arg] = kind
            arguments.append(f"{kind} {self._c_name(argument.arg)}".replace("* ", "*"))
        given = set(self._types)
        returns = self._all.returns[self._name]
        for kind in (*self._types.values(), returns):
            if kind.startswith("spool_") and kind != MEMORY:
                self._all.tuple_type([MEMORY if one == "m" else _DOUBLE for one in kind[6:]])
        for statement in node.body:
            self._statement(statement)
        head = f"static inline {returns} {self._name}({', '.join(arguments) or 'void'})"
        declared = [
            f"    {kind} {self._c_name(name)};" for name, kind in self._types.items() if name not in given
        ]
        self._all.functions.append("\n".join([head, "{", *declared, *self._lines, "}"]))

    def _where(self, node: ast.AST) -> str:
        return f"{self._module}.{self._source.node.name}, line {getattr(node, 'lineno', 0)}"

    def _refuse(self, node: ast.AST) -> InputError:
        said = " ".join(ast.unparse(node).split())[:60]
        return InputError(
            f"{self._where(node)}: '{said}' cannot be exported to C: use numbers, tuples, math, if and for"
        )

    @staticmethod
    def _c_name(name: str) -> str:
        return f"{name}_" if name in _RESERVED else name

    def _emit(self, line: str) -> None:
        self._lines.append("    " * self._depth + line)

    def _declare(self, name: str, kind: str, node: ast.AST) -> str:
        known = self._types.setdefault(name, kind)
        if known != kind and not (known == _DOUBLE and kind == _INT):
            raise self._refuse(node)
        return self._c_name(name)

    def _fresh(self, kind: str) -> str:
        self._temporary += 1
        name = f"part_{self._temporary}"
        self._types[name] = kind
        return name

    def _block(self, body: Sequence[ast.stmt]) -> None:
        self._depth += 1
        for statement in body:
            self._statement(statement)
        self._depth -= 1

    def _statement(self, node: ast.stmt) -> None:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            self._assign(node.targets[0], node.value)
        elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
            self._assign(node.target, ast.copy_location(ast.BinOp(node.target, node.op, node.value), node))
        elif isinstance(node, ast.Return) and node.value is not None:
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            text = ", ".join(self._value(one)[0] for one in values)
            if isinstance(node.value, ast.Tuple):
                returns = self._all.returns[self._name]
                text = f"({returns}){{{{{text}}}}}" if returns == MEMORY else f"({returns}){{{text}}}"
            self._emit(f"return {text};")
        elif isinstance(node, ast.Break):
            self._emit("break;")
        elif isinstance(node, ast.Continue):
            self._emit("continue;")
        elif isinstance(node, ast.If):
            self._emit(f"if ({self._value(node.test)[0]}) {{")
            self._block(node.body)
            if node.orelse:
                self._emit("} else {")
                self._block(node.orelse)
            self._emit("}")
        elif isinstance(node, ast.For) and not node.orelse:
            self._loop(node)
        else:
            raise self._refuse(node)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name):
            text, kind = self._value(value)
            self._emit(f"{self._declare(target.id, kind, value)} = {text};")
            return
        if not isinstance(target, ast.Tuple):
            raise self._refuse(target)
        if isinstance(value, ast.Tuple):
            parts = [self._value(one) for one in value.elts]
            kept = [self._fresh(kind) for _, kind in parts]
            for name, (text, _) in zip(kept, parts, strict=True):
                self._emit(f"{name} = {text};")
            found = list(zip(kept, (kind for _, kind in parts), strict=True))
        else:
            found = self._parts(value)
        for one, (text, kind) in zip(target.elts, found, strict=True):
            if not isinstance(one, ast.Name):
                raise self._refuse(target)
            if one.id != "_":
                self._emit(f"{self._declare(one.id, kind, value)} = {text};")

    def _parts(self, value: ast.expr) -> list[tuple[str, str]]:
        """Return the parts of the tuple that a call returns, as text and type."""
        text, kind = self._value(value)
        if not kind.startswith("spool_") or kind == MEMORY:
            raise self._refuse(value)
        name = self._fresh(kind)
        self._emit(f"{name} = {text};")
        return [
            (f"{name}.f{number}", MEMORY if one == "m" else _DOUBLE) for number, one in enumerate(kind[6:])
        ]

    def _loop(self, node: ast.For) -> None:
        source = node.iter
        if isinstance(source, ast.Call) and isinstance(source.func, ast.Name) and source.func.id == "range":
            if len(source.args) != 1 or not isinstance(node.target, ast.Name):
                raise self._refuse(node)
            name = self._fresh(_INT) if node.target.id == "_" else self._declare(node.target.id, _INT, node)
            self._emit(f"for ({name} = 0; {name} < {self._value(source.args[0])[0]}; ++{name}) {{")
            self._block(node.body)
            self._emit("}")
            return
        if isinstance(source, ast.Tuple) and isinstance(node.target, ast.Tuple):
            rows = [row.elts if isinstance(row, ast.Tuple) else [row] for row in source.elts]
            table = [[self._value(one) for one in row] for row in rows]
            targets = node.target.elts
        else:
            table = [[part] for part in self._parts(source)]
            targets = [node.target]
        counter = self._fresh(_INT)
        self._emit(f"for ({counter} = 0; {counter} < {len(table)}; ++{counter}) {{")
        self._depth += 1
        for column, target in enumerate(targets):
            if not isinstance(target, ast.Name):
                raise self._refuse(node)
            text = table[-1][column][0]
            for row in reversed(range(len(table) - 1)):
                text = f"{counter} == {row} ? {table[row][column][0]} : {text}"
            self._emit(f"{self._declare(target.id, table[0][column][1], node)} = {text};")
        self._depth -= 1
        self._block(node.body)
        self._emit("}")

    def _value(self, node: ast.expr) -> tuple[str, str]:
        """Return an expression in C and its type."""
        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            return _literal(node.value)
        if isinstance(node, ast.Name):
            return self._named(node)
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "math" and node.attr in _CONSTANTS:
            return _CONSTANTS[node.attr], _DOUBLE
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
            text, kind = self._value(node.operand)
            return f"({_OPERATORS[type(node.op)]}{text})", _INT if isinstance(node.op, ast.Not) else kind
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        if isinstance(node, ast.BoolOp):
            joined = f" {_OPERATORS[type(node.op)]} ".join(self._value(one)[0] for one in node.values)
            return f"({joined})", _INT
        if isinstance(node, ast.Compare) and all(type(one) in _OPERATORS for one in node.ops):
            terms = [self._value(one)[0] for one in (node.left, *node.comparators)]
            pairs = [
                f"({terms[place]} {_OPERATORS[type(one)]} {terms[place + 1]})"
                for place, one in enumerate(node.ops)
            ]
            return f"({' && '.join(pairs)})", _INT
        if isinstance(node, ast.IfExp):
            test = self._value(node.test)[0]
            (yes, kind), (no, other) = self._value(node.body), self._value(node.orelse)
            return f"({test} ? {yes} : {no})", kind if kind == other else _DOUBLE
        if isinstance(node, ast.Subscript):
            text, kind = self._value(node.value)
            place, whole = self._value(node.slice)
            if whole == _INT and kind in (PARAMETERS, MEMORY):
                return (f"{text}[{place}]" if kind == PARAMETERS else f"{text}.values[{place}]"), _DOUBLE
        if isinstance(node, ast.Call) and not node.keywords:
            return self._call(node)
        parts = [self._value(one) for one in node.elts] if isinstance(node, ast.Tuple) else []
        if parts and {kind for _, kind in parts} <= {_DOUBLE, _INT, MEMORY}:
            name = self._all.tuple_type([MEMORY if kind == MEMORY else _DOUBLE for _, kind in parts])
            return f"({name}){{{', '.join(text for text, _ in parts)}}}", name
        raise self._refuse(node)

    def _named(self, node: ast.Name) -> tuple[str, str]:
        if node.id in self._types:
            return self._c_name(node.id), self._types[node.id]
        if node.id in ("MASS", "EVENTS"):
            return node.id, _INT
        module, name = self._source.imports.get(node.id, (self._module, node.id))
        value = getattr(importlib.import_module(module), name, None)
        if not isinstance(value, bool | int | float):
            raise self._refuse(node)
        return _literal(value)

    def _binary(self, node: ast.BinOp) -> tuple[str, str]:
        (left, one), (right, other) = self._value(node.left), self._value(node.right)
        if isinstance(node.op, ast.Pow):
            return f"pow({left}, {right})", _DOUBLE
        if type(node.op) not in _OPERATORS or MEMORY in (one, other):
            raise self._refuse(node)
        whole = one == other == _INT and not isinstance(node.op, ast.Div)
        if isinstance(node.op, ast.Div) and one == other == _INT:
            left = f"(double){left}"
        return f"({left} {_OPERATORS[type(node.op)]} {right})", _INT if whole else _DOUBLE

    def _call(self, node: ast.Call) -> tuple[str, str]:
        given = [self._value(one) for one in node.args]
        called = ast.unparse(node.func)
        if self._source.imports.get(called, ("", ""))[0] == "math":
            called = f"math.{self._source.imports[called][1]}"
        if called.startswith("math.") or called in ("abs", "min", "max"):
            name = _C_NAMES.get(called.removeprefix("math."))
            if name is None or (name.startswith("spool_") and len(given) != 2):
                raise self._refuse(node)
            return f"{name}({', '.join(text for text, _ in given)})", _INT if name == "isnan" else _DOUBLE
        module, law = self._source.imports.get(called, (self._module, called))
        name = called if self._module == _KERNEL else re.sub(r"\W", "_", f"{module}_{law}")
        if called in self._source.functions:
            source = self._source.functions[called]
            self._all.add(_Source(source, self._source.functions, self._source.imports), name, module)
        elif called in self._source.imports:
            self._all.add_law(module, law, name)
        else:
            raise self._refuse(node)
        return f"{name}({', '.join(text for text, _ in given)})", self._all.returns[name]


def _literal(value: bool | int | float) -> tuple[str, str]:
    """Return a number in C and its type."""
    if isinstance(value, bool | int):
        return str(int(value)), _INT
    if not math.isfinite(value):
        return ("NAN" if math.isnan(value) else "INFINITY" if value > 0.0 else "-INFINITY"), _DOUBLE
    return repr(value), _DOUBLE


def model_source(terms: Sequence[Term]) -> str:
    """Return laws and time step of ``terms`` as C, every function ``static``.

    Raises:
        InputError: a law uses something that has no translation; file, line and code are named.
    """
    places = {one.name: f"q[{place}]" for place, one in enumerate(unique_parameters(terms))}
    drag = [
        entry.call(number, places, "force_law", "z", "v", "t")
        for number, entry in enumerate(terms)
        if "force_law" in entry.laws and (entry.dissipates or entry.jumps)
    ]
    # Friction that is continuous in the motion, N, which an FMU shows separately.
    head = "def drag(z: float, v: float, t: float, q: Numbers) -> float:"
    text = f"{kernel_source(terms)}\n\n{head}\n    return {' + '.join(drag) or '0.0'}"
    functions, imports = parsed(text)
    found = Translation()
    for name in ROOTS:
        found.add(_Source(functions[name], functions, imports), name, _KERNEL)
    return found.text(terms)
