"""Laws in C: for every law of the catalogue the numbers of Python; what has no translation is refused."""

from __future__ import annotations

import ctypes
import os
import random
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_design.c_source import Translation
from spool_sim.terms import TERMS
from spool_sim.terms.base import LAWS

#: Drawn points for each law.
POINTS = 200
EVERY = [(entry, law) for entry in TERMS.values() for law in entry.laws]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Every law as a function of an array of arguments that fills an array of results."""
    folder = tmp_path_factory.mktemp("laws")
    found = Translation()
    for entry, law in EVERY:
        function = entry.function(law)
        found.add_law(function.__module__, function.__name__, f"{entry.name}_{law}")
    lines = [found.text()]
    for entry, law in EVERY:
        name = f"{entry.name}_{law}"
        known = (*LAWS[law], *(one.name for one in entry.parameters))
        call = f"{name}({', '.join(f'in[{known.index(one)}]' for one in entry.arguments(law))})"
        pair = found.returns[name] == "spool_dd"
        body = f"spool_dd two = {call}; out[0] = two.f0; out[1] = two.f1;" if pair else f"out[0] = {call};"
        lines.append(f"void call_{name}(const double *in, double *out) {{ {body} }}")
    (folder / "laws.c").write_text("\n".join(lines), "utf-8")
    compiler = shlex.split(os.environ.get("CC", "cc"))
    options = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "laws.c", "-o", "laws.so", "-lm"]
    subprocess.run([*compiler, *options], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "laws.so"))


@pytest.mark.parametrize(("entry", "law"), EVERY, ids=lambda value: getattr(value, "name", value))
def test_a_law_in_c_has_the_values_of_python(entry, law, library) -> None:  # type: ignore[no-untyped-def]
    draw = random.Random(f"{entry.name} {law}")
    python = entry.uncompiled(law)
    ranges = {
        "z": (-4e-3, 4e-3), "v": (-0.4, 0.4), "t": (0.0, 30.0), "speed": (0.0, 0.4), "force": (-0.5, 0.5),
        "slip": (0.0, 1e-4), "acceleration": (-20.0, 20.0),
    }  # fmt: skip
    for _ in range(POINTS):
        side = draw.choice((-1.0, 1.0))
        point = [side if name == "direction" else draw.uniform(*ranges[name]) for name in LAWS[law]]
        if law == "memory_law":
            point[1] *= side
        given = [
            min(max(one.start * draw.uniform(0.5, 2.0), one.low), one.high) if one.start else 0.0
            for one in entry.parameters
        ]
        out = (ctypes.c_double * 2)()
        arguments = [*point, *given]
        getattr(library, f"call_{entry.name}_{law}")((ctypes.c_double * len(arguments))(*arguments), out)
        wanted = python(*arguments)
        wanted = list(wanted) if isinstance(wanted, tuple) else [wanted]
        assert list(out)[: len(wanted)] == pytest.approx(wanted, rel=4e-15, abs=1e-300)


def test_helpers_of_one_name_in_two_laws_stay_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = Translation()
    monkeypatch.syspath_prepend(tmp_path)
    for number in (1, 2):
        module = f"helped_law_{number}"
        helper = f"from math import exp\n\n\ndef curve(z: float) -> float:\n    return {number}.0 * exp(z)\n"
        law = "def force_law(z: float, v: float, t: float) -> float:\n    return curve(z)\n"
        (tmp_path / f"{module}.py").write_text(f"{helper}\n\n{law}", "utf-8")
        found.add_law(module, "force_law", f"force_law_{number}")
    text = found.text()
    assert "return (1.0 * exp(z));" in text
    assert "return (2.0 * exp(z));" in text


@pytest.mark.parametrize(
    ("body", "named"),
    [
        ("return sum([z, v])", "[z, v]"),
        ("while z > 1.0:\n        z -= 1.0\n    return z", "while z > 1.0"),
        ("return math.gamma(z)", "math.gamma(z)"),
        ("return TABLE[0] * z", "TABLE"),
    ],
)
def test_a_law_without_a_translation_is_refused_with_its_place(
    body: str, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head = "def force_law(z: float, v: float, t: float) -> float:"
    source = f"import math\n\nTABLE = [1.0]\n\n\n{head}\n    {body}\n"
    (tmp_path / "odd_law.py").write_text(source, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    sys.modules.pop("odd_law", None)
    with pytest.raises(InputError) as refused:
        Translation().add_law("odd_law", "force_law", "force_law")
    assert str(refused.value).startswith("odd_law.force_law, line 7: ")
    assert named in str(refused.value)
    assert "cannot be exported to C" in str(refused.value)
