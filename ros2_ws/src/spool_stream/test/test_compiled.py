from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import spool_stream
from spool_stream.kernels.kernel_folder import refusal

CODE = """
import sys
if {blocked}:
    sys.modules["numba"] = None  # what an import of a missing package meets
from spool_stream.kernels import compiled

@compiled.compiled
def twice(x):
    return 2.0 * x

import spool_stream.kernels.compiled
print(compiled.COMPILED, compiled.notice() is None, hasattr(twice, "py_func"), twice(1.5))
"""


def run(folder: Path, *, blocked: bool) -> subprocess.CompletedProcess[str]:
    script = folder / "script.py"  # the cache on disk needs a file
    script.write_text(CODE.format(blocked=blocked))
    path = str(Path(spool_stream.__file__).parents[1])
    return subprocess.run(
        [
            sys.executable,
            "-c",
            f"import sys; sys.path.insert(0, {path!r}); import runpy; runpy.run_path({str(script)!r})",
        ],
        capture_output=True,
        text=True,
        check=True,
    )


def test_with_numba_functions_are_compiled_in_silence(tmp_path: Path) -> None:
    done = run(tmp_path, blocked=False)
    assert done.stdout.split() == ["True", "True", "True", "3.0"]
    assert done.stderr == ""


def test_without_numba_functions_run_as_they_are_and_one_line_says_what_it_costs(tmp_path: Path) -> None:
    done = run(tmp_path, blocked=True)
    assert done.stdout.split() == ["False", "False", "False", "3.0"]
    assert len(done.stderr.splitlines()) == 1
    assert "100 times slower" in done.stderr


def ran(folder: Path, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a process that finds packages in ``folder`` and knows nothing of this one's kernels."""
    stream = str(Path(spool_stream.__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": f"{stream}:{folder}", **environment},
        capture_output=True,
        text=True,
        check=True,
    )


@pytest.mark.slow
def test_only_a_change_in_what_a_kernel_uses_makes_it_old(tmp_path: Path) -> None:
    package = tmp_path / "four_files"
    package.mkdir()
    head = "from spool_stream.kernels.compiled import compiled\n"
    files = {
        "__init__": "",
        "constants": "FACTOR = 2.0\n",
        "other": "UNUSED = 1\n",
        "called": f"{head}\n@compiled\ndef one():\n    return 1.0\n",
        "caller": f"{head}from .called import one\nfrom .constants import (  # comment, with a comma\n"
        "    FACTOR as SIZE,\n)\n\n@compiled\ndef times(x):\n    return one() * SIZE * x\n",
    }
    changes = [
        files,
        {"other": "UNUSED = 2\n"},
        {"constants": "FACTOR = 5.0\n"},
        {"called": files["called"].replace("1.0", "3.0")},
    ]
    found = []
    for change in changes:
        for name, text in change.items():
            (package / f"{name}.py").write_text(text)
        done = ran(
            tmp_path,
            "from four_files.caller import times; print(times(1.0))",
            NUMBA_CACHE_DIR=str(tmp_path / "cache"),
        )
        kept = list((tmp_path / "cache" / "spool_kernels").iterdir())  # one for each state of a module
        found.append((float(done.stdout), len(kept)))
    assert found == [(2.0, 2), (2.0, 2), (5.0, 3), (15.0, 5)]


def test_kernels_are_kept_elsewhere_where_they_can_t_be(tmp_path: Path) -> None:
    wanted, temporary = tmp_path / "wanted", tmp_path / "temporary"
    temporary.mkdir()
    wanted.touch()
    (tmp_path / "one_file").mkdir()
    (tmp_path / "one_file" / "__init__.py").write_text(
        "from spool_stream.kernels.compiled import compiled\n\n@compiled\ndef half(x):\n    return 0.5 * x\n"
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
