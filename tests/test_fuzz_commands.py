"""Every command on damaged and absurd input: never a traceback, never 1 GB more, always an end.

A small sample, the same at every run, is part of the suite. ``SPOOL_FUZZ_EXAMPLES=500 ./spool test
tests/test_fuzz_commands.py`` draws so many new ones of each kind.
"""

from __future__ import annotations

import gzip
import os
import re
import shutil
import sqlite3
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from spool_monitor.trend import Sums, TrendStore
from spool_sim.valve import shipped_valves
from spool_tools.cli import main

from .forks import completed

EXAMPLES = int(os.environ.get("SPOOL_FUZZ_EXAMPLES", "0"))
#: What a command may take more than what is loaded before it starts, B.
MEMORY = 1_000_000_000
#: s of processor time; the longest of them, a gap analysis of 4 s, takes 5 s.
PATIENCE = 120
SPOOL = Path(__file__).resolve().parent.parent / "spool"
VALVE = shipped_valves()["4weh10_soft"]
STAMP = 1_735_732_800_000_000_000

Draw = Callable[..., Any]


def sample(examples: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the settings of one kind of input: ``examples`` in the suite."""
    return settings(
        max_examples=EXAMPLES or examples,
        derandomize=not EXAMPLES,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


#: Runs one command within its limits.
LIMITED = f"""
import resource, signal, sys
from pathlib import Path
from spool_tools.cli import main

pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
limit = pages * resource.getpagesize() + {MEMORY}
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
resource.setrlimit(resource.RLIMIT_CPU, ({PATIENCE}, {PATIENCE}))
signal.alarm(5 * {PATIENCE})
sys.exit(main(sys.argv[1:]))
"""


def check(folder: Path, *arguments: str) -> None:
    """Fail unless the command ends with 0, 1 or 2, and with 2 in one line that is fit to be shown."""
    done = completed(["-c", LIMITED, *arguments], folder=folder, environment=os.environ, timeout=6 * PATIENCE)
    event(f"{arguments[0]} ended with {done.returncode}")  # shown by --hypothesis-show-statistics
    shown = f"spool {' '.join(arguments)}\n{done.stderr[-4000:]}"
    assert done.returncode in (0, 1, 2), f"ended with {done.returncode}: {shown}"
    assert "Traceback" not in done.stderr, shown
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", done.stderr.replace("\r", "")), repr(done.stderr)
    errors = [line for line in done.stderr.splitlines() if line.startswith("spool: ")]
    assert len(errors) == (done.returncode == 2), shown
    assert all(len(line) < 5000 for line in done.stderr.splitlines()), shown


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sound record, bag, state and files to damage."""
    folder = tmp_path_factory.mktemp("good")
    bag = str(folder / "bag")
    assert main(["simulate", "--out", bag, "--seconds", "4", "--excitation", "multisine"]) == 0
    assert main(["export", bag, "--out", str(folder / "exported.csv")]) == 0
    rows = (folder / "exported.csv").read_text("utf-8").splitlines()
    columns = rows[0].split(",")
    wanted = [columns.index(name) for name in ("time_s", "body_m_s2", "spool_m_s2")]
    kept = [",".join(row.split(",")[index] for index in wanted) for row in rows]
    (folder / "record.csv").write_text("\n".join(kept) + "\n", "utf-8")
    (folder / "valve.yaml").write_bytes(VALVE.read_bytes())
    (folder / "model.yaml").write_text(
        "name: mine\nterms: [inertia, spring, viscous_friction, coulomb_friction]\nparameters:\n"
        "  coulomb_force: 0.3\n",
        "utf-8",
    )
    (folder / "excitation.yaml").write_text("kind: steady_sine\nfrequency: 20.0\namplitude: 5.0\n", "utf-8")
    (folder / "sensors.yaml").write_text(
        "body:\n  noise: 0.01\nspool:\n  noise: 0.01\n  gain_error: 0.1\n", "utf-8"
    )
    (folder / "state" / "valve_1" / "monitor").mkdir(parents=True)
    store = TrendStore(folder / "state" / "valve_1" / "monitor" / "trends.sqlite")
    sums = Sums()
    for minute in range(50):
        sums.add(STAMP + minute * 60_000_000_000, "coulomb_force", "N", 0.1 + 0.001 * minute)
    store.write(sums)
    store.close()
    return folder


@pytest.fixture
def folder() -> Iterator[Callable[[], Path]]:
    """Make a folder for each example; they go with the test."""
    with tempfile.TemporaryDirectory() as base:
        yield lambda: Path(tempfile.mkdtemp(dir=base))


ODD = st.sampled_from(
    ["", "0", "-0.0", "-1", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "1e400", "9" * 400, "=1+1",
     "\x1b[31mred", "\x00", "1,5", "'", '"', "[", "{}", "null", "true", "~", "2020-99-99", "*a", "&a 1", "<<",
     "!!python/object:os.system x", "a" * 5000, "../../x", "-", "--", "1:2:3", "0x10", "1e-6", "1000", "%s"]
)  # fmt: skip


@st.composite
def damaged(draw: Draw, content: bytes, longest: int = 4096) -> bytes:
    """Bytes changed, cut out, doubled, zeroed or put in, up to three times."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, max(0, len(data) - 1)))
        length = draw(st.integers(1, longest))
        piece = data[start : start + length]
        match draw(st.sampled_from(["flip", "cut", "zero", "double", "end", "put"])):
            case "flip" if data:
                data[start] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del data[start : start + length]
            case "zero":
                data[start : start + length] = bytes(len(piece))
            case "double":
                data[start:start] = piece
            case "end":
                del data[start:]
            case "put":
                data[start:start] = draw(ODD).encode()
    return bytes(data)


@st.composite
def odd_text(draw: Draw, text: str) -> str:
    """Single values of a table or of a YAML file replaced by odd ones, lines doubled and dropped."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 4))):
        number = draw(st.integers(0, len(lines) - 1))
        match draw(st.sampled_from(["value", "value", "value", "key", "double", "drop", "column"])):
            case "value":
                lines[number] = re.sub(r"[^,: ]+$", lambda _: draw(ODD), lines[number])
            case "key":
                lines[number] = re.sub(r"^[^,:]+", lambda _: draw(ODD), lines[number])
            case "double":
                lines.insert(number, lines[number])
            case "drop" if len(lines) > 1:
                del lines[number]
            case "column":
                lines = [f"{line},{draw(ODD)}" for line in lines] if len(lines) < 50 else lines
    return "\n".join(lines) + "\n"


def put(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogateescape"))
    return path


RECORDS = st.sampled_from(["import", "replay", "fit", "compare", "gap", "info"])


@sample(8)
@given(data=st.data(), command=RECORDS, packed=st.booleans())
def test_records(good: Path, folder: Callable[[], Path], data: Any, command: str, packed: bool) -> None:
    here = folder()
    text = (good / "record.csv").read_bytes()
    content = data.draw(st.one_of(damaged(text), odd_text(text.decode()).map(str.encode)))
    if packed:
        content = data.draw(st.one_of(st.just(gzip.compress(content)), damaged(gzip.compress(content))))
    record = str(put(here / ("record.csv.gz" if packed else "record.csv"), content))
    valve = ("--valve", "4weh10_soft")
    more: dict[str, tuple[str, ...]] = {
        "import": ("--out", "bag"),
        "replay": (*valve, "--json", "result.json"),
        "fit": (*valve, "--model", "coulomb"),
        "compare": (*valve, "--models", "fluid,coulomb"),
        "gap": (*valve, "--json", "result.json"),
        "info": (),
    }
    check(here, command, record, *more[command])


@sample(10)
@given(data=st.data(), command=st.sampled_from(["info", "recover", "export", "replay", "fit"]))
def test_bags(good: Path, folder: Callable[[], Path], data: Any, command: str) -> None:
    here = folder()
    shutil.copytree(good / "bag", here / "bag")
    (part,) = (here / "bag").glob("*.mcap")
    if data.draw(st.integers(0, 3)):
        put(part, data.draw(damaged(part.read_bytes())))
    else:
        description = here / "bag" / "metadata.yaml"
        text = description.read_text("utf-8")
        put(description, data.draw(st.one_of(damaged(text.encode(), 200), odd_text(text).map(str.encode))))
    more: dict[str, tuple[str, ...]] = {
        "info": ("--json", "result.json"),
        "recover": ("--out", "saved"),
        "export": ("--out", data.draw(st.sampled_from(["table.csv", "table.parquet"]))),
        "replay": ("--valve", "4weh10_soft", "--json", "result.json"),
        "fit": ("--valve", "4weh10_soft", "--model", "fluid"),
    }
    check(here, command, "bag", *more[command])


@sample(10)
@given(data=st.data(), kind=st.sampled_from(["valve", "model", "excitation", "sensors"]))
def test_yaml_files(good: Path, folder: Callable[[], Path], data: Any, kind: str) -> None:
    here = folder()
    text = (good / f"{kind}.yaml").read_text("utf-8")
    content = data.draw(st.one_of(odd_text(text).map(str.encode), damaged(text.encode(), 40)))
    put(here / f"{kind}.yaml", content)
    check(here, "simulate", "--out", "bag", "--seconds", "1", f"--{kind}", f"{kind}.yaml")


NUMBERS = st.sampled_from(["0", "-1", "nan", "inf", "1e-9", "0.5", "1", "3", "1e4", "", "x", "1,5", "1e999"])
OPTIONS = {
    "simulate": (
        "--sample-rate",
        "--block-rate",
        "--coulomb-force",
        "--noise",
        "--seed",
        "--oil-temperature",
    ),
    "fit": (
        "--fix",
        "--free",
        "--start",
        "--stop",
        "--columns",
        "--sensor-delay",
        "--report",
        "--save-model",
    ),
    "compare": ("--models", "--columns", "--json", "--report", "--sensor-gain", "--stop"),
    "gap": ("--base", "--kind", "--columns", "--delay-tolerance", "--gain-tolerance", "--start"),
    "replay": ("--valve", "--refit-model", "--refit-period", "--json"),
    "trend": ("--since", "--parameter", "--out", "--json"),
    "export": ("--out", "--valve"),
    "import": ("--columns", "--start", "--name"),
}


@pytest.mark.slow
@sample(12)
@given(data=st.data(), command=st.sampled_from(sorted(OPTIONS)))
def test_options(good: Path, folder: Callable[[], Path], data: Any, command: str) -> None:
    here = folder()
    needed: dict[str, tuple[str, ...]] = {
        "simulate": ("--out", "bag", "--seconds", "1"),
        "fit": (str(good / "record.csv"), "--valve", "4weh10_soft", "--model", "fluid"),
        "compare": (str(good / "record.csv"), "--valve", "4weh10_soft", "--models", "fluid"),
        "gap": (str(good / "record.csv"), "--valve", "4weh10_soft"),
        "replay": (str(good / "bag"),),
        "trend": ("valve_1", "--state-folder", str(good / "state")),
        "export": (str(good / "bag"),),
        "import": (str(good / "record.csv"), "--out", "bag"),
    }
    option = data.draw(st.sampled_from(OPTIONS[command]))
    value = data.draw(st.one_of(NUMBERS, ODD.filter(lambda text: "\x00" not in text)))
    check(here, command, *needed[command], f"{option}={value}")


@sample(4)
@given(data=st.data())
def test_kept_trends(good: Path, folder: Callable[[], Path], data: Any) -> None:
    here = folder()
    shutil.copytree(good / "state", here / "state")
    path = here / "state" / "valve_1" / "monitor" / "trends.sqlite"
    if data.draw(st.booleans()):
        put(path, data.draw(damaged(path.read_bytes())))
    else:
        base = sqlite3.connect(path)
        column = data.draw(st.sampled_from(["start", "count", "total", "minimum", "maximum"]))
        value = data.draw(st.sampled_from(["x", None, 10**18, -(10**18), 9e999, -1, b"\x00"]))
        base.execute(f"UPDATE OR IGNORE span SET {column} = coalesce(?, {column})", (value,))
        base.commit()
        base.close()
    check(here, "trend", "valve_1", "--state-folder", "state", "--out", "trend.html", "--json", "a.json")


def test_the_reader_of_the_output_may_end_early_or_not_be_there(good: Path, tmp_path: Path) -> None:
    command = f"{SPOOL} info {good / 'bag'}"
    for ending in ("| true", ">&-", ">&- 2>&-"):
        done = subprocess.run(
            ["bash", "-c", f"{command} {ending}"], capture_output=True, text=True, timeout=180, check=False
        )
        assert done.stderr == "", ending
    made = subprocess.run(
        ["bash", "-c", f"{SPOOL} simulate --seconds 1 --out {tmp_path / 'bag'} >&- 2>&- <&-"],
        timeout=180, check=False,
    )  # fmt: skip
    assert made.returncode == 0
    assert main(["info", str(tmp_path / "bag")]) == 0
