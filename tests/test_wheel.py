"""The wheel in a clean environment without ROS: the README's path from a logger's file to a gap report."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
UV = str(Path(sys.executable).with_name("uv"))
SECTION = "## From a logger's file and a data sheet to what the model lacks"


def uv(environment: dict[str, str], *arguments: str | Path) -> None:
    subprocess.run([UV, "-q", *map(str, arguments)], env=environment, check=True)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the program ``spool`` of a new environment in which only the wheel is installed."""
    folder = tmp_path_factory.mktemp("wheel")
    environment = {
        key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")
    }
    python = folder / "environment"
    uv(environment, "venv", "--python", sys.executable, python)
    uv(environment, "build", "--wheel", "-o", folder, ROOT)
    uv(environment, "pip", "install", "--python", python, *folder.glob("*.whl"))
    return folder / "environment" / "bin" / "spool"


def run(program: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the installed program in the locale C, where nothing is UTF-8 by itself."""
    environment = {"PATH": os.environ["PATH"], "HOME": os.environ["HOME"], "LC_ALL": "C"}
    return subprocess.run(
        [str(program), *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def readme_commands() -> list[list[str]]:
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition(SECTION)[2]
    block = re.findall(r"^```bash\n(.*?)^```", text, re.S | re.M)[0].replace("\\\n", " ")
    return [shlex.split(line)[1:] for line in block.splitlines()]


@pytest.mark.slow
def test_the_path_of_the_readme_ends_in_a_gap_report(program: Path, tmp_path: Path) -> None:
    python = program.with_name("python")
    assert subprocess.run([python, "-c", "import rclpy"], capture_output=True, check=False).returncode == 1
    folder = tmp_path / "Prüfstand 4 links"
    folder.mkdir()
    (folder / "bags").symlink_to(ROOT / "bags")
    commands = readme_commands()
    assert [words[0] for words in commands] == ["valve", "valve", "import", "import", "gap"]
    for words in commands:
        done = run(program, folder, *words, *(["--json", "gap.json"] if words[0] == "gap" else []))
        assert done.returncode == 0, done.stderr
    assert json.loads((folder / "gap.json").read_text("utf-8"))["verdict"] == "coulomb_friction"
    assert (folder / "press_4_left.html").stat().st_size > 100_000


@pytest.mark.slow
def test_a_command_that_needs_ros_says_so_in_one_line(program: Path, tmp_path: Path) -> None:
    for words in (["demo"], ["watch"], ["alarm", "list", "valve_1"], ["doctor", "--live"]):
        done = run(program, tmp_path, *words)
        assert done.returncode == 2
        assert re.fullmatch(r"spool: this needs ROS 2 \(\w+ is missing\): .*\n", done.stderr)


@pytest.mark.slow
def test_a_file_with_umlauts_and_line_ends_of_windows_is_read(program: Path, tmp_path: Path) -> None:
    rows = "\r\n".join(f"{k / 1000};{k % 7},5;{k % 5},25" for k in range(4000))
    path = tmp_path / "Messung für Größe.csv"
    path.write_bytes(f"time_s;body_m_s2;spool_m_s2\r\n{rows}\r\n".replace(".", ",").encode("cp1252"))
    done = run(program, tmp_path, "import", path.name, "--out", "Aufnahme groß")
    assert (done.returncode, done.stderr) == (0, "")
    done = run(program, tmp_path, "info", "Aufnahme groß", "--json", "info.json")
    assert json.loads((tmp_path / "info.json").read_text("utf-8"))["valves"]
