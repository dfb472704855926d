"""The core without add-ons, and with one: linked as the set-up does, from a tree that holds just these."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from setup.layout import Layout, find_underlay
from setup.workspace import base_environment, link_packages, run_environment

ROOT = Path(__file__).resolve().parent.parent
BAG = ROOT / "bags" / "practice_03"
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(name="core")
def _core(tmp_path: Path) -> Callable[..., Run]:
    """Return what links the core and the named add-ons, and returns what runs `spool` of these."""
    own = Layout(ROOT, find_underlay(ROOT, os.environ))

    def linked(*add_ons: str) -> Run:
        tree = tmp_path / "tree"
        (tree / "ros2_ws" / "addons").mkdir(parents=True)
        (tree / "ros2_ws" / "src").symlink_to(ROOT / "ros2_ws" / "src")
        for name in add_ons:
            (tree / "ros2_ws" / "addons" / name).symlink_to(ROOT / "ros2_ws" / "addons" / name)
        (tree / ".venv").symlink_to(own.venv)
        core = Layout(tree, own.underlay)
        link_packages(core, base_environment(own, os.environ))
        for path in (*own.install.glob("share/**/spool_msgs"), *own.install.glob("lib/*/*/spool_msgs")):
            place = core.install / path.relative_to(own.install)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(path)
        environment = run_environment(core, os.environ)

        def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
            program = core.install / "lib" / "spool_bringup" / "spool"
            return subprocess.run(
                [program, *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
            )

        return run

    return linked


def test_the_core_alone_does_all_but_what_add_ons_do(core: Callable[..., Run], tmp_path: Path) -> None:
    spool = core()
    assert "Add-ons" not in spool("--help").stdout
    for words in (
        ("simulate", "--seconds", "4", "--valve", "4weh10_soft", "--out", "made"),
        ("export", BAG, "--out", "record.csv"),
        ("import", "record.csv", "--out", "imported"),
        ("fit", "imported", "--valve", "4weh10_soft", "--json", "fit.json"),
        ("replay", BAG, "--valve", "4weh10_soft", "--json", "replay.json"),
    ):
        done = spool(*words)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "fit.json").stat().st_size > 1000
    for name in ("setups.yaml", "rig.csv"):
        (tmp_path / name).touch()
    for name, words in (
        ("spool_fleet", ("fleet", "add", BAG, "--store", "store")),
        ("spool_opcua", ("run", "spool_view", "opcua", "--ros-args", "-p", "port:=1")),
        ("spool_design", ("what-if", "--valve", "4weh10_soft")),
        ("spool_design", ("plan", "--question", "end_stop")),
        ("spool_design", ("fit", "--setups", "setups.yaml", "--valve", "4weh10_soft")),
        ("spool_design", ("export", "4weh10_soft", "--fmu", "valve.fmu")),
        ("spool_rigs", ("gap", "rig.csv", "--kind", "imposed")),
    ):
        refused = spool(*words)
        assert refused.returncode == 2, words
        assert refused.stderr.count("\n") == 1
        assert f"add-on {name}: put its folder into ros2_ws/addons" in refused.stderr
    for name, call in (
        ("spool_fleet", "fleet('store').query('SELECT 1')"),
        ("spool_design", "what_if('4weh10_soft')"),
        ("spool_design", "fit_setups('setups.yaml', '4weh10_soft')"),
        ("spool_design", "export_fmu('4weh10_soft', 'valve.fmu')"),
        ("spool_rigs", "gap('rig.csv', kind='driven')"),
    ):
        refused = spool("python", "-c", f"import spool; spool.{call}")
        last = refused.stderr.splitlines()[-1]
        assert last.startswith(f"spool_core.errors.InputError: this is in the add-on {name}: "), call


def test_the_fleet_beside_the_core_brings_its_command(core: Callable[..., Run]) -> None:
    spool = core("spool_fleet")
    assert "Add-ons" in spool("--help").stdout
    done = spool("fleet", "add", BAG.parent, "--store", "store")
    assert done.returncode == 0, done.stderr
    done = spool("fleet", "query", "--store", "store", "SELECT count(*) AS bags FROM bags")
    assert done.returncode == 0, done.stderr


def test_the_opc_ua_server_beside_the_core_has_its_node(core: Callable[..., Run]) -> None:
    done = core("spool_opcua")("run", "spool_view", "opcua", "--help")
    assert done.returncode == 0, done.stderr
    assert "security_folder" in done.stdout


def test_the_desk_tools_beside_the_core_have_their_commands_and_options(core: Callable[..., Run]) -> None:
    spool = core("spool_design")
    for words in (("what-if", "--valve", "4weh10_soft"), ("export", "4weh10_soft", "--fmu", "valve.fmu")):
        done = spool(*words)
        assert done.returncode == 0, done.stderr
    refused = spool("fit", "--setups", "no_such.yaml", "--valve", "4weh10_soft")
    assert (refused.returncode, "no_such.yaml" in refused.stderr) == (2, True)


def test_the_rigs_beside_the_core_analyse_forces(core: Callable[..., Run], tmp_path: Path) -> None:
    time = np.arange(0.0, 8.0, 5e-3)
    place = 0.02 * np.sin(2.5 * time) + 0.01 * np.sin(6.9 * time)
    force = 30.0 * np.gradient(place, time) + 400.0 * place + 1e-3 * np.sin(1e4 * time)
    rows, header = np.transpose([time, place, force]), "time_s,displacement_m,force_N"
    np.savetxt(tmp_path / "rig.csv", rows, delimiter=",", header=header, comments="")
    done = core("spool_rigs")("gap", "rig.csv", "--kind", "imposed", "--report", "gap.html")
    assert done.returncode == 0, done.stderr
    assert "Left out: a record of force" in (tmp_path / "gap.html").read_text("utf-8")
