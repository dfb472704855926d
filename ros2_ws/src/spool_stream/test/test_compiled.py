from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import spool_stream

CODE = """
import sys
if {blocked}:
    sys.modules["numba"] = None  # what an import of a missing package meets
from spool_stream import compiled

@compiled.compiled
def twice(x):
    return 2.0 * x

import spool_stream.compiled
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
