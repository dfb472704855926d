"""Node processes: how executables are found, and that none is left behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_tools.operations.node_processes import Nodes, find_executable


def install(prefix: Path, package: str, *executables: str) -> Path:
    marker = prefix / "share/ament_index/resource_index/packages" / package
    marker.parent.mkdir(parents=True)
    marker.touch()
    for name in executables:
        path = prefix / "lib" / package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("#!/bin/sh\n", "utf-8")
        path.chmod(0o755)
    return prefix


def test_the_first_prefix_that_has_it_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = install(tmp_path / "one", "some_package", "other")
    two, three = (install(tmp_path / name, "some_package", "node") for name in ("two", "three"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{one}::{two}:{three}")
    assert find_executable("some_package", "node") == two / "lib/some_package/node"


def test_what_is_not_there_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefix = install(tmp_path, "some_package", "beta", "alpha")
    (prefix / "lib/some_package/data.txt").write_text("not executable", "utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    with pytest.raises(InputError, match="package other_package is not installed"):
        find_executable("other_package", "node")
    with pytest.raises(InputError, match=r"some_pakage is not installed; did you mean some_package\?$"):
        find_executable("some_pakage", "node")
    with pytest.raises(InputError, match=r"; did you mean alpha\?$"):
        find_executable("some_package", "alhpa")
    with pytest.raises(InputError, match=r"no executable node; it has: alpha, beta$"):
        find_executable("some_package", "node")
    with pytest.raises(InputError, match=r"no executable data\.txt"):
        find_executable("some_package", "data.txt")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    with pytest.raises(InputError, match="is the workspace built and sourced"):
        find_executable("some_package", "alpha")


def test_a_package_without_executables_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(install(tmp_path, "some_messages")))
    with pytest.raises(InputError, match=r"it has: none$"):
        find_executable("some_messages", "node")


def test_leaving_ends_every_process_also_one_that_will_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (install(tmp_path, "some_package", "node") / "lib/some_package/node").write_text(
        f"#!{sys.executable}\n"
        "import signal, sys, time\n"
        "if sys.argv[1] == 'deaf': signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "if sys.argv[1] == 'short': sys.exit(3)\n"
        "open(sys.argv[2], 'w').close()\n"
        "signal.pause() if sys.argv[1] != 'deaf' else [signal.pause() for _ in range(9)]\n",
        "utf-8",
    )
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with Nodes(tmp_path / "nodes.log") as nodes:
        for name in ("good", "deaf", "short"):
            nodes.start(name, "some_package", "node", [name, str(tmp_path / f"{name}.up")])
        processes = dict(nodes.running)
        assert processes["short"].wait(timeout=180) == 3
        while not ((tmp_path / "good.up").exists() and (tmp_path / "deaf.up").exists()):
            assert processes["good"].poll() is None
            assert processes["deaf"].poll() is None
        assert nodes.dead() == ["short"]
        nodes.stop("deaf", patience=0.2)
        assert processes["deaf"].returncode == -9
        assert set(nodes.running) == {"good", "short"}
    assert processes["good"].returncode in (-2, 1)
    assert nodes.running == {}
    assert "KeyboardInterrupt" in (tmp_path / "nodes.log").read_text("utf-8")
    assert isinstance(processes["good"], subprocess.Popen)
