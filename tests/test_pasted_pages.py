"""The commands of README and commissioning page, pasted in their order into one folder."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from spool_msgs.msg import ValveHealth
from spool_tools.cli import app, main
from typer.main import get_command

from .conftest import Process

if TYPE_CHECKING:
    from .conftest import System

ROOT = Path(__file__).resolve().parent.parent
PAGES = (ROOT / "README.md", ROOT / "docs" / "commissioning.md")
#: Commands that are not run here, and why.
NOT_RUN = {
    "demo": "takes a minute: tests/test_demo.py runs it",
    "test": "runs this test",
    "play": "stays until Ctrl-C: tests/test_play.py runs it",
    "doctor": "judges this machine, not the page",
}
#: Commands that need running nodes.
LIVE = {"run", "alarm", "baseline", "param", "trend"}
#: Commands that take half a minute each: without -m slow they are parsed, and their output files made.
LONG = {"gap", "compare", "fit"}
OUTPUTS = {"json", "report", "out", "save_model"}


@dataclass(frozen=True, slots=True)
class Pasted:
    """A command of a page: its words behind ``./spool``, or the text of a file that the page writes."""

    page: str
    words: tuple[str, ...]
    written: str = ""

    @property
    def command(self) -> str:
        return self.words[0]


def pasted() -> Iterator[Pasted]:
    """Yield the commands of all blocks in their order."""
    for page in PAGES:
        for block in re.findall(r"^```bash\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M):
            text = block.replace("\\\n", " ")
            for name, content, line in re.findall(
                r"^cat > (\S+) <<'END'\n(.*?)^END$|^(.+)$", text, re.S | re.M
            ):
                if name:
                    yield Pasted(page.name, ("cat", name), content)
                    continue
                for one in line.splitlines():
                    program, *words = shlex.split(one, comments=True) or [""]
                    assert program in ("", "./spool"), f"{page.name}: {one}"
                    if words:
                        yield Pasted(page.name, tuple(words))


def parse(words: Sequence[str]) -> None:
    """Parse a command, which checks its output files, and make these files."""
    group: Any = get_command(app)
    command = group.get_command(group.make_context("spool", [words[0]]), words[0])
    context = command.make_context(words[0], list(words[1:]))
    for name, value in context.params.items():
        if name in OUTPUTS and isinstance(value, Path):
            value.write_text("made by the test", "utf-8")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to paste into; the sample records stand in it, as in a clone."""
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("long", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["short", "all"])
def test_commands_on_records_work_one_after_the_other(
    folder: Path, capsys: pytest.CaptureFixture[str], long: bool
) -> None:
    run = []
    for one in pasted():
        if one.written:
            (folder / one.words[1]).write_text(one.written, "utf-8")
        elif one.command in LONG and not long:
            parse(one.words)
        elif one.command not in LIVE | NOT_RUN.keys():
            code = main(list(one.words))
            assert code == 0, f"{one.page}: {' '.join(one.words)}: {capsys.readouterr().err}"
            run.append(one.command)
    assert {"valve", "import", "export", "info", "replay", "check"} <= set(run)
    assert "limits of limits.yaml: coulomb_change 0.2 N" in capsys.readouterr().out


def start(system: System, folder: Path, one: Pasted) -> Process:
    """Start a node as the page does."""
    log = folder / f"{len(system.processes)}.log"
    with log.open("wb") as output:
        popen = subprocess.Popen(
            [ROOT / "spool", *one.words],
            cwd=folder, env=system.environment, stdin=subprocess.DEVNULL, stdout=output,
            stderr=subprocess.STDOUT,
        )  # fmt: skip
    system.processes.append(Process(" ".join(one.words), popen, log))
    return system.processes[-1]


@pytest.mark.slow
def test_commands_of_running_nodes_work_on_them(system: System, folder: Path) -> None:
    (described,) = [one for one in pasted() if one.page != "README.md" and one.words[:2] == ("valve", "new")]
    assert main(list(described.words)) == 0
    live = [one for one in pasted() if one.command in LIVE]
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)

    def ask(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [ROOT / "spool", *words],
            cwd=folder, env=system.environment, capture_output=True, text=True, check=False, timeout=180,
        )  # fmt: skip

    for one in (one for one in live if one.page == "README.md"):
        start(system, folder, one)
    system.until(lambda: health.heard, "the README's monitor is up")
    assert [process.end() for process in system.processes] == [0, 0, 0]

    health.heard.clear()
    page = [one for one in live if one.page != "README.md"]
    nodes = [start(system, folder, one) for one in page if one.command == "run"]
    system.until(
        lambda: health.heard and health.last.level == ValveHealth.LEVEL_OK, "the page's nodes judge the valve"
    )
    for one in page:
        if one.command not in ("run", "trend"):
            done = ask(*one.words)
            # A list with alarms ends with 1; a machine that is busy with other tests loses blocks.
            fine = (0, 1) if one.words[:2] == ("alarm", "list") else (0,)
            assert done.returncode in fine, f"{' '.join(one.words)}: {done.stderr}"
    assert "coulomb_change  0.2" in ask("param", "get", "valve_1", "coulomb_change").stdout
    refused = ask("param", "set", "valve_1", "amplification_on=1.2", "minimum_body=0.6")
    assert refused.returncode == 2
    assert refused.stderr.splitlines() == [
        "spool: valve_1/monitor: amplification_off (1.5) must lie below amplification_on (1.2): "
        "otherwise an event would clear immediately"
    ]
    for change, reason in (
        ("gain_change=7", "0.02"),
        ("coulomb_chang=1", "no parameter coulomb_chang; did you mean coulomb_change?"),
        ("coulomb_change=much", "coulomb_change=much: give a number"),
    ):
        wrong = ask("param", "set", "valve_1", change)
        assert (wrong.returncode, len(wrong.stderr.splitlines())) == (2, 1)
        assert reason in wrong.stderr
    assert "minimum_body  0.5" in ask("param", "get", "valve_1", "minimum_body").stdout
    # The monitor writes its trends when it ends, or after 10 s of data.
    assert [process.end() for process in nodes] == [0] * len(nodes)
    for one in page:
        if one.command == "trend":
            assert ask(*one.words).returncode == 0


def test_a_files_name_means_one_kind_of_file_in_all_texts() -> None:
    """``my_valve.yaml`` is a valve description, ``limits.yaml`` and ``nodes.yaml`` are parameter files."""
    folders = (ROOT / "docs", ROOT / "ros2_ws/src", ROOT / "ros2_ws/addons", ROOT / "setup")
    texts = [
        path for folder in folders for path in folder.rglob("*") if path.suffix in {".md", ".py", ".yaml"}
    ]
    assert len(texts) > 500
    files = r"(params[-_]file(:=|[ =])|--model )\S*my_valve\.yaml"
    wrong = re.compile(files + r"|(--valve|valve_file:=?|--model) ?(limits|nodes)\.yaml")
    found = [
        f"{path}: {one[0]}" for path in (*PAGES, *texts) for one in wrong.finditer(path.read_text("utf-8"))
    ]
    assert found == []
