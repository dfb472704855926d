from __future__ import annotations

import importlib
import logging
import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
import spool_core
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spool_core.kernels import kernel_files
from spool_core.kernels.kernel_files import refusal

CODE = """
import sys
if {blocked}:
    sys.modules["numba"] = None  # what an import of a missing package meets
from spool_core.kernels import compiled

@compiled.compiled
def twice(x):
    return 2.0 * x

import spool_core.kernels.compiled
print(compiled.COMPILED, compiled.notice() is None, hasattr(twice, "py_func"), twice(1.5))
"""


def ran(folder: Path, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a process that finds packages in ``folder`` and knows nothing of this one's kernels."""
    stream = str(Path(spool_core.__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": f"{stream}:{folder}", **environment},
        capture_output=True,
        text=True,
        check=True,
    )


def test_with_numba_functions_are_compiled_in_silence(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(CODE.format(blocked=False), "utf-8")  # the cache needs a file
    done = ran(tmp_path, "import script")
    assert done.stdout.split() == ["True", "True", "True", "3.0"]
    assert done.stderr == ""


def test_without_numba_functions_run_as_they_are_and_one_line_says_what_it_costs(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(CODE.format(blocked=True), "utf-8")
    done = ran(tmp_path, "import script")
    assert done.stdout.split() == ["False", "False", "False", "3.0"]
    assert len(done.stderr.splitlines()) == 1
    assert "100 times slower" in done.stderr


HEAD = """
from enum import IntEnum
from typing import NamedTuple
import numpy as np
from spool_core.kernels.compiled import compiled, inlined
"""
#: Modules of a package with one kernel, which takes code and constants in every way from the others.
SOURCES = {
    "__init__": "",
    "base": "BASE = 1.0\nOTHER = 4.0\n\ndef other():\n    return 'text'\n",
    "constants": "from .base import BASE\nFACTOR = 2.0 * BASE\nUNUSED = 1.0\n",
    "again": "from .constants import *\n",
    "gains": f"{HEAD}GAIN = 3.0\nTABLE = np.array([1.0, 2.0])\nclass Side(IntEnum):\n    RIGHT = 2\n",
    "points": f"{HEAD}class Point(NamedTuple):\n    left: float\n    right: float\n",
    "called": f"""{HEAD}
@compiled
def one(z, by=1.0):
    return 1.0 * by

@inlined
def half(z: float) -> float:
    return 0.5 * z
""",
    "caller": f"""{HEAD}
from . import gains
from .again import FACTOR as SIZE
from .called import half, one

@compiled
def times(x, point):
    inner = lambda y: y * gains.TABLE[1]
    y = one(x) * SIZE * half(x) * gains.GAIN * inner(x)
    return y + 100.0 * point.left + 1000.0 * gains.Side.RIGHT.value
""",
}
#: What a kernel takes: module, text, and what stands in its place.
USED = (
    ("constants", "2.0 * BASE", "7.0"),
    ("base", "BASE = 1.0", "BASE = 5.0"),
    ("called", "return 1.0", "return 1.7"),
    ("called", "by=1.0", "by=1.3"),
    ("called", "0.5 * z", "0.7 * z"),
    ("gains", "GAIN = 3.0", "GAIN = 2.0"),
    ("gains", "[1.0, 2.0]", "[1.0, 9.0]"),
    ("gains", "RIGHT = 2", "RIGHT = 6"),
    ("points", "    left: float\n    right: float\n", "    right: float\n    left: float\n"),
    ("caller", "100.0", "300.0"),
)
#: What no kernel takes.
UNUSED = (
    ("base", "'text'", "'another text'"),
    ("base", "OTHER = 4.0", "OTHER = 5.0"),
    ("constants", "UNUSED = 1.0", "UNUSED = 2.0"),
    ("called", "    return 1.0", "    'Say what it is for.'\n    # And why.\n    return 1.0"),
    ("called", "z: float", "z: int"),
    ("caller", "\n@compiled", "\n\n# Further down.\nMORE = 1\n\n@compiled"),
)


@pytest.fixture
def changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[float, float, int]]:
    """Return what runs the kernel of ``SOURCES`` with a change: its value, the one due, compilations."""
    folder = tmp_path / "package_of_a_kernel"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # two changes may come in one second

    def run(module: str = "base", old: str = "BASE", new: str = "BASE") -> tuple[float, float, int]:
        for name, text in SOURCES.items():
            (folder / f"{name}.py").write_text(text.replace(old, new) if name == module else text, "utf-8")
        for name in [name for name in sys.modules if name.startswith(folder.name)]:
            monkeypatch.delitem(sys.modules, name)
        importlib.invalidate_caches()
        points = vars(importlib.import_module(f"{folder.name}.points"))
        point = points["Spot" if "Spot" in points else "Point"](left=2.0, right=3.0)
        kernel = importlib.import_module(f"{folder.name}.caller").times
        value = kernel(1.0, point)
        return value, kernel.py_func(1.0, point), sum(kernel.stats.cache_misses.values())

    return run


def test_a_kernel_is_never_served_stale(changed: Callable[..., tuple[float, float, int]]) -> None:
    values = {changed()[0]}
    for change in USED:
        value, due, compilations = changed(*change)
        assert (change, value, compilations) == (change, pytest.approx(due), 1)
        values.add(value)
    assert len(values) == len(USED)  # each of these changes shows but that fields change places


def test_a_class_of_an_argument_that_was_renamed_is_no_error(
    changed: Callable[..., tuple[float, float, int]],
) -> None:
    changed()
    assert changed("points", "Point", "Spot")[0] == changed()[0]


def test_a_change_that_a_kernel_does_not_take_keeps_it(
    changed: Callable[..., tuple[float, float, int]],
) -> None:
    assert changed()[2] == 1
    assert [change for change in UNUSED if changed(*change)[2]] == []


def test_a_constant_that_changes_while_the_process_runs_makes_another_kernel(
    changed: Callable[..., tuple[float, float, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    value, *_ = changed()
    kernel = sys.modules["package_of_a_kernel.caller"].times
    monkeypatch.setitem(kernel.py_func.__globals__, "SIZE", 20.0)
    point = sys.modules["package_of_a_kernel.points"].Point(2, 3)  # of integers: compiled apart
    assert kernel(1.0, point) == pytest.approx(kernel.py_func(1.0, point))
    assert changed()[0] == value


def test_kernels_are_kept_elsewhere_where_they_can_t_be(tmp_path: Path) -> None:
    wanted, temporary = tmp_path / "wanted", tmp_path / "temporary"
    temporary.mkdir()
    wanted.touch()
    (tmp_path / "one_file").mkdir()
    (tmp_path / "one_file" / "__init__.py").write_text(
        "from spool_core.kernels.compiled import compiled\n\n@compiled\ndef half(x):\n    return 0.5 * x\n",
        "utf-8",
    )
    code = "from one_file import half; print(half(3.0))"
    done = ran(tmp_path, code, NUMBA_CACHE_DIR=str(wanted), TMPDIR=str(temporary))
    assert done.stdout.split() == ["1.5"]
    (line,) = done.stderr.splitlines()
    assert f"compiled kernels are not kept in {wanted}" in line
    assert "can't be written" in line
    assert list(temporary.rglob("*.nbc"))
    assert {stat.S_IMODE(path.stat().st_mode) for path in temporary.glob("spool_*")} == {0o700}


@pytest.mark.parametrize("above", [False, True])
def test_kernels_are_not_loaded_from_where_others_could_change_them(tmp_path: Path, above: bool) -> None:
    folder = tmp_path / "wanted" / "spool_kernels"
    folder.mkdir(parents=True, mode=0o755)
    (folder.parent if above else folder).chmod(0o777)
    assert "everybody may write in" in (refusal(folder) or "")
    (folder.parent if above else folder).chmod(0o755)
    assert refusal(folder) is None


KERNELS = (
    "from spool_core.kernels.compiled import compiled\n\n@compiled\ndef thrice(x):\n    return 3.0 * x\n"
)


def damaged(stored: bytes, damage: str) -> bytes:
    half = len(stored) // 2
    return {
        "empty": b"",
        "halved": stored[:half],
        "zeroed": bytes(len(stored)),
        "first bit": bytes([stored[0] ^ 1]) + stored[1:],
        "middle bit": stored[:half] + bytes([stored[half] ^ 16]) + stored[half + 1 :],
        "last bit": stored[:-1] + bytes([stored[-1] ^ 128]),
        "longer": stored + b"\0",
    }[damage]


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Return a module of kernels whose cache, in ``tmp_path / "cache"``, holds ``thrice`` of a float."""
    name = f"kernels_{tmp_path.name.translate(str.maketrans('-[]', '___'))}"
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text(KERNELS, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    module = importlib.import_module(name)
    assert module.thrice(1.5) == 4.5
    yield module
    del sys.modules[name]


def test_a_kept_kernel_is_loaded_and_not_compiled(kernels: ModuleType) -> None:
    again = importlib.reload(kernels)
    assert again.thrice(1.5) == 4.5
    assert sum(again.thrice.stats.cache_hits.values()) == 1
    assert not again.thrice.stats.cache_misses


def test_a_damaged_kernel_file_is_compiled_again_and_logged(
    kernels: ModuleType, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, logger=kernel_files.__name__)
    (file,) = (tmp_path / "cache").rglob("*.nbc")
    for damage in ("empty", "halved", "zeroed", "first bit", "middle bit", "last bit", "longer"):
        file.write_bytes(damaged(file.read_bytes(), damage))
        assert kernel_files.damaged_files(tmp_path / "cache") == [file]
        caplog.clear()
        again = importlib.reload(kernels)
        assert again.thrice(1.5) == 4.5
        assert sum(again.thrice.stats.cache_misses.values()) == 1
        assert f"{file} cannot be read" in caplog.text
        assert kernel_files.damaged_files(tmp_path / "cache") == []
        assert sum(importlib.reload(kernels).thrice.stats.cache_misses.values()) == 0


def test_the_first_damaged_file_of_a_process_is_a_warning(kernels: ModuleType, tmp_path: Path) -> None:
    for file in (tmp_path / "cache").rglob("*.nbc"):
        file.write_bytes(b"")
    code = f"from {kernels.__name__} import thrice; print(thrice(1.5))"
    done = ran(tmp_path, code, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert done.stdout.split() == ["4.5"]
    (line,) = done.stderr.splitlines()
    assert "cannot be read (its checksum differs): its kernel is compiled again" in line


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7), cut=st.booleans())
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_flipped_bit_and_no_cut_changes_what_a_kernel_returns(
    kernels: ModuleType, tmp_path: Path, place: float, bit: int, cut: bool
) -> None:
    for file in (tmp_path / "cache").rglob("*.nbc"):
        stored = bytearray(file.read_bytes())
        at = int(place * len(stored))
        stored[at] ^= 1 << bit
        file.write_bytes(stored[:at] if cut else stored)
    assert importlib.reload(kernels).thrice(1.5) == 4.5


def test_a_kernel_file_in_the_place_of_another_is_not_loaded(kernels: ModuleType, tmp_path: Path) -> None:
    assert kernels.thrice(2) == 6.0
    one, other = (tmp_path / "cache").rglob("*.nbc")
    swapped = one.read_bytes(), other.read_bytes()
    other.write_bytes(swapped[0])
    one.write_bytes(swapped[1])
    again = importlib.reload(kernels)
    assert (again.thrice(1.5), again.thrice(2)) == (4.5, 6.0)
    assert sum(again.thrice.stats.cache_misses.values()) == 2


def test_a_file_of_another_version_of_numba_is_not_loaded_and_is_no_damage(
    kernels: ModuleType, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("numba.__version__", "0.1")
    again = importlib.reload(kernels)
    assert again.thrice(1.5) == 4.5
    assert sum(again.thrice.stats.cache_misses.values()) == 1
    assert not caplog.text


def test_processes_that_compile_at_one_time_leave_a_cache_of_both(
    kernels: ModuleType, tmp_path: Path
) -> None:
    for file in (tmp_path / "cache").rglob("*.nbc"):
        file.write_bytes(file.read_bytes()[:-7])
    code = "import sys, {0}; sys.stdin.read(); print({0}.thrice({1}))"
    path = f"{Path(spool_core.__file__).parents[1]}:{tmp_path}"
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code.format(kernels.__name__, number)],
            env={**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for number in ("1.5", "2")
    ]  # fmt: skip
    for process in processes:
        assert process.stdin is not None
        process.stdin.close()
    said = [process.stdout.read().strip() for process in processes if process.stdout is not None]
    assert [process.wait(180) for process in processes] == [0, 0]
    assert said == ["4.5", "6.0"]
    again = importlib.reload(kernels)
    assert (again.thrice(1.5), again.thrice(2)) == (4.5, 6.0)
    assert not again.thrice.stats.cache_misses


def test_a_disk_that_takes_no_kernel_is_no_error(
    kernels: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_arguments: object, **_named: object) -> None:
        raise OSError(28, "No space left on device")

    for file in (tmp_path / "cache").rglob("*.nbc"):
        file.unlink()
    again = importlib.reload(kernels)
    monkeypatch.setattr(kernel_files.system, "write_durably", full)
    assert again.thrice(1.5) == 4.5
