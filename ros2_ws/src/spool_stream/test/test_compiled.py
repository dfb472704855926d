from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import spool_stream

CODE = """
import sys
if {blocked}:
    sys.modules["numba"] = None  # what an import of a missing package meets
from spool_stream import compiled

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


def test_a_change_in_a_function_that_a_kernel_calls_is_seen(tmp_path: Path) -> None:
    package = tmp_path / "two_files"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(
        "from spool_stream.kernels.compiled import compiled\nfrom .called import factor\n\n"
        "@compiled\ndef times(x):\n    return factor() * x\n"
    )
    stream = str(Path(spool_stream.__file__).parents[1])
    found = []
    for factor in (2.0, 3.0):
        (package / "called.py").write_text(
            "from spool_stream.kernels.compiled import compiled\n\n"
            f"@compiled\ndef factor():\n    return {factor}\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", "from two_files.caller import times; print(times(1.0))"],
            env={
                **os.environ,
                "PYTHONPATH": f"{stream}:{tmp_path}",
                "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            },
            capture_output=True,
            text=True,
            check=True,
        )
        found.append(float(done.stdout))
    assert found == [2.0, 3.0]


@pytest.mark.parametrize("trouble", ["no folder", "open to all", "open above it"])
def test_kernels_are_kept_elsewhere_where_they_can_t_be_or_others_could_change_them(
    tmp_path: Path, trouble: str
) -> None:
    wanted, temporary = tmp_path / "wanted", tmp_path / "temporary"
    temporary.mkdir()
    if trouble == "no folder":
        wanted.touch()
    else:
        (wanted / "spool_kernels").mkdir(parents=True, mode=0o755)
        (wanted if trouble == "open above it" else wanted / "spool_kernels").chmod(0o777)
    stream = str(Path(spool_stream.__file__).parents[1])
    package = tmp_path / "one_file"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from spool_stream.kernels.compiled import compiled\n\n@compiled\ndef half(x):\n    return 0.5 * x\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", "from one_file import half; print(half(3.0))"],
        env={
            **os.environ,
            "PYTHONPATH": f"{stream}:{tmp_path}",
            "NUMBA_CACHE_DIR": str(wanted),
            "TMPDIR": str(temporary),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["1.5"]
    (line,) = done.stderr.splitlines()
    assert f"compiled kernels are not kept in {wanted}" in line
    assert ("can't be written" if trouble == "no folder" else "everybody may write in") in line
    assert list(temporary.rglob("*.nbc"))
    assert {stat.S_IMODE(path.stat().st_mode) for path in temporary.glob("spool_*")} == {0o700}


def test_only_a_change_in_what_a_module_imports_makes_its_kernels_old(tmp_path: Path) -> None:
    package = tmp_path / "three_files"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "constants.py").write_text("FACTOR = 2.0\n")
    (package / "other.py").write_text("UNUSED = 1\n")
    (package / "caller.py").write_text(
        "from spool_stream.kernels.compiled import compiled\n\n"
        "from .constants import (  # comment, with a comma\n"
        "    FACTOR as SIZE,\n)\n\n@compiled\ndef times(x):\n    return SIZE * x\n"
    )
    stream = str(Path(spool_stream.__file__).parents[1])
    found = []
    for file, text in (("other", "UNUSED = 2\n"), ("other", "UNUSED = 3\n"), ("constants", "FACTOR = 5.0\n")):
        (package / f"{file}.py").write_text(text)
        done = subprocess.run(
            [sys.executable, "-c", "from three_files.caller import times; print(times(1.0))"],
            env={
                **os.environ,
                "PYTHONPATH": f"{stream}:{tmp_path}",
                "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            },
            capture_output=True,
            text=True,
            check=True,
        )
        folders = len(list((tmp_path / "cache" / "spool_kernels").iterdir()))
        found.append((float(done.stdout), folders))
    assert found == [(2.0, 1), (2.0, 1), (5.0, 2)]
