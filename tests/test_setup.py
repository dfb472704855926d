"""Set-up by real calls of `./spool`: what goes wrong ends in one line, what was begun is gone on with."""

import base64
import fcntl
import hashlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import uuid
import zipfile
from pathlib import Path

import pytest
from spool_core.kernels.kernel_files import wanted_kernel_folder

from setup.layout import WHEELS, Layout, Underlay, find_underlay
from setup.packages import UV, failure, uv_settings
from setup.workspace import base_environment

ROOT = Path(__file__).resolve().parent.parent
TOOLS = ("sh", "bash", "env", "readlink", "dirname", "cat", "mkdir", "rm", "uname")
COMPILERS = ("cc", "c++", "make")
PYTHON = os.path.realpath(getattr(sys, "_base_executable", sys.executable))
OWN = (
    "SPOOL_",
    "ROS_",
    "AMENT_",
    "CMAKE_",
    "COLCON_",
    "PYTHON",
    "PYTEST",
    "LD_LIBRARY",
    "VIRTUAL_ENV",
    "RMW_",
    "_ROS_",
)
PATIENCE_S = 600
SOME_PACKAGES = 20  # of 190, so that the installation is under way
READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0"'


def clean_environment(**changes: str) -> dict[str, str]:
    """The machine's environment without what this very test run has set."""
    own_bin = str(Path(sys.prefix) / "bin")
    path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if part != own_bin)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(OWN)}
    return kept | {"PATH": path, "SPOOL_PYTHON": PYTHON} | changes


def spool(folder: Path, *arguments: str, **changes: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [folder / "spool", *arguments],
        env=clean_environment(**changes),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def start(folder: Path, *arguments: str, **changes: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [folder / "spool", *arguments],
        env=clean_environment(**changes),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def read_until(process: subprocess.Popen[str], text: str) -> str:
    """What a running call says up to and with `text`."""
    said = ""
    while text not in said:
        character = process.stderr.read(1)
        assert character, f"it ended before saying {text!r}: {said}"
        said += character
    return said


def assert_one_line(result: subprocess.CompletedProcess[str], *parts: str, code: int = 2) -> None:
    """The call ended with one line on stderr, after the announced steps, that says all of `parts`."""
    assert result.returncode == code, result.stderr
    lines = [line for line in result.stderr.splitlines() if line and not line.startswith("[")]
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("spool: ")
    for part in parts:
        assert part in lines[0]
    assert result.stdout == ""


@pytest.fixture
def fresh(tmp_path: Path) -> Path:
    """The project as it is, without anything that was set up; the sources are those of the project."""
    folder = tmp_path / "project with a space"
    (folder / "ros2_ws").mkdir(parents=True)
    for name in ("src", "addons"):
        (folder / "ros2_ws" / name).symlink_to(ROOT / "ros2_ws" / name)
    shutil.copy2(ROOT / "spool", folder)
    for name in ("setup", "requirements"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def folder_of_tools(folder: Path, *names: str) -> str:
    folder.mkdir()
    for name in names:
        (folder / name).symlink_to(shutil.which(name) or pytest.fail(f"{name} is not on PATH"))
    return str(folder)


class TestBeforeSetUp:
    def test_help_needs_no_set_up(self, fresh: Path):
        result = spool(fresh, "--help")
        assert result.returncode == 0
        assert "demo" in result.stdout
        assert not (fresh / ".setup").exists()

    @pytest.mark.parametrize(
        ("missing", "said"), [("c++", "a C++ compiler"), ("cc", "a C compiler"), ("make", "make")]
    )
    def test_missing_tool(self, fresh: Path, tmp_path: Path, missing: str, said: str):
        there = [name for name in COMPILERS if name != missing]
        path = folder_of_tools(tmp_path / "bin", *TOOLS, *there)
        result = spool(fresh, "demo", PATH=path, CC="", CXX="")
        assert_one_line(result, said, "apt install build-essential")

    @pytest.mark.parametrize(
        ("variables", "said"),
        [
            (None, ("no command dmeo", "--help")),
            ({"SPOOL_PYTHON": "/nowhere/python"}, ("/nowhere/python", "is no program")),
            (
                {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/opt/ros/nowhere"},
                ("ROS_DISTRO=jazzy", "AMENT_PREFIX_PATH", "source"),
            ),
            (
                {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/"},  # a folder that is there
                ("cannot import rclpy", "SPOOL_PYTHON"),
            ),
        ],
    )
    def test_what_cannot_work_is_refused(
        self, fresh: Path, variables: dict[str, str] | None, said: tuple[str, ...]
    ):
        assert_one_line(spool(fresh, "dmeo" if variables is None else "demo", **(variables or {})), *said)

    @pytest.mark.parametrize(
        ("version", "distribution", "taken"),
        [("3, 9, 1", "", False), ("3, 14, 0", "", False), ("3, 14, 0", "lyrical", True)],
    )
    def test_a_python_without_wheels_is_taken_where_a_newer_ros_is_sourced(
        self, fresh: Path, tmp_path: Path, version: str, distribution: str, taken: bool
    ):
        """The launcher alone: a stand-in says that it is another Python."""
        other = tmp_path / "other-python"
        pretend = f"import sys; sys.version_info = ({version}); exec(sys.argv[1])"
        other.write_text(
            f'#!/bin/sh\n[ "$1" = -c ] && exec "{PYTHON}" -c \'{pretend}\' "$2"\necho taken; exit 0\n',
            "utf-8",
        )
        other.chmod(0o755)
        result = spool(fresh, "demo", SPOOL_PYTHON=str(other), ROS_DISTRO=distribution)
        assert (result.stdout == "taken\n") is taken
        if not taken:
            assert_one_line(result, str(other), "no working Python 3.10 to 3.13")

    def test_no_python(self, fresh: Path, tmp_path: Path):
        path = folder_of_tools(tmp_path / "bin", *TOOLS)
        assert_one_line(
            spool(fresh, "demo", PATH=path, SPOOL_PYTHON=""), "no Python 3.10 to 3.13", "SPOOL_PYTHON"
        )

    def test_a_shim_that_fails_is_passed_over(self, fresh: Path, tmp_path: Path):
        path = folder_of_tools(tmp_path / "bin", *TOOLS)
        for name in ("python3", "python3.13"):
            (tmp_path / "bin" / name).write_text("#!/bin/sh\nexit 127\n", "utf-8")
            (tmp_path / "bin" / name).chmod(0o755)
        (tmp_path / "second").mkdir()
        (tmp_path / "second" / "python3").symlink_to(PYTHON)
        result = spool(fresh, "--help", PATH=f"{path}:{tmp_path / 'second'}", SPOOL_PYTHON="")
        assert result.returncode == 0, result.stderr

    @pytest.mark.parametrize(
        ("level", "variables", "said"),
        [
            ("", {}, "not set up yet: ./spool demo does it"),
            ("problem", {"ROS_LOCALHOST_ONLY": "1"}, "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"),
            ("warning", {}, "discovery range SUBNET: anyone on this network may"),
            ("warning", {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "acknowledge and shelve alarms; set"),
            ("warning", {"ROS_SECURITY_ENABLE": "true"}, "messages are sent and recorded in clear"),
            (
                "warning",
                {"NUMBA_CACHE_DIR": "shared"},
                "compiled kernels are not kept in {folder}/shared/spool_kernels",
            ),
            ("warning", {"XDG_CACHE_HOME": "shared"}, "everybody may write in {folder}/shared"),
        ],
    )
    def test_doctor_reports_what_is_missing_and_what_lets_others_in(
        self, fresh: Path, tmp_path: Path, level: str, variables: dict[str, str], said: str
    ):
        (tmp_path / "shared").mkdir()
        (tmp_path / "shared").chmod(0o777)
        here = {
            name: str(tmp_path / value) if value == "shared" else value for name, value in variables.items()
        }
        result = spool(fresh, "doctor", **here)
        assert result.returncode == (level == "problem")
        assert any(
            said.format(folder=tmp_path) in line and line.startswith(level)
            for line in result.stdout.splitlines()
        ), result.stdout

    def test_doctor_is_content_with_what_only_this_machine_can_reach(self, fresh: Path, tmp_path: Path):
        result = spool(
            fresh, "doctor", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", NUMBA_CACHE_DIR=str(tmp_path / "own")
        )
        assert "ok       discovery range LOCALHOST" in result.stdout
        assert f"ok       compiled kernels are kept in {tmp_path}/own" in result.stdout

    def test_doctor_names_a_damaged_file_of_compiled_kernels(self, fresh: Path, tmp_path: Path):
        folder = tmp_path / "own" / "spool_kernels" / "module_0123"
        folder.mkdir(parents=True, mode=0o700)
        (folder / "kernel-1.py311.nbc").touch()
        result = spool(fresh, "doctor", NUMBA_CACHE_DIR=str(tmp_path / "own"))
        assert result.returncode == 0
        assert (
            f"warning  damaged files of compiled kernels: 1, the first is {folder / 'kernel-1.py311.nbc'}"
            in result.stdout
        )

    def test_doctor_names_a_missing_compiler(self, fresh: Path, tmp_path: Path):
        result = spool(fresh, "doctor", PATH=folder_of_tools(tmp_path / "bin", *TOOLS, "make"), CC="", CXX="")
        assert result.returncode == 1
        assert "problem  not found on PATH: a C++ compiler" in result.stdout

    def test_read_only_folder(self, fresh: Path):
        mount = f'{READ_ONLY} && exec "$0/spool" demo'
        assert_one_line(in_own_mounts(mount, fresh), "cannot be written", "make the folder writable")

    def test_disk_too_small(self, fresh: Path, tmp_path: Path):
        small = tmp_path / "small"
        small.mkdir()
        mount = f'mount -t tmpfs -o size=64m none "{small}" && cp -r "$0" "{small}/p"'
        assert_one_line(
            in_own_mounts(f'{mount} && exec "{small}/p/spool" demo', fresh), "GB free", "free some space"
        )

    def test_second_set_up_waits(self, fresh: Path, tmp_path: Path):
        notes = fresh / ".setup" / "on_wheels"
        notes.mkdir(parents=True)
        with (notes / "busy.lock").open("w", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            process = start(fresh, "demo", PATH=folder_of_tools(tmp_path / "bin", *TOOLS))
            read_until(process, "another set-up is at work")
        _, said = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 2
        assert "compiler" in said


def in_own_mounts(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a shell script that mounts what nobody else sees; `$0` is the folder."""
    unshare = ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "-rm"]
    return subprocess.run(
        [*unshare, "sh", "-c", script, folder],
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=False,
    )


class TestIndexesOfPip:
    def test_uv_is_told_what_pip_was_told(self, tmp_path: Path):
        told = uv_settings(
            {
                "index-url": "https://packages.example/simple",
                "extra-index-url": f"https://more.example/simple file://{tmp_path} file:///not/there",
                "find-links": f"{tmp_path} /not/there",
                "cert": "/etc/own.pem",
                "trusted-host": "packages.example",
            }
        )
        assert told["UV_DEFAULT_INDEX"] == "https://packages.example/simple"
        assert told["UV_INDEX"] == f"https://more.example/simple file://{tmp_path}"
        assert told["UV_FIND_LINKS"] == str(tmp_path)
        assert told["SSL_CERT_FILE"] == "/etc/own.pem"
        assert told["UV_INSECURE_HOST"] == "packages.example"

    @pytest.mark.parametrize(("provider", "told"), [("auto", "subprocess"), ("disabled", None)])
    def test_uv_identifies_itself_as_pip_does(self, provider: str, told: str | None):
        found = uv_settings({"client-cert": "/etc/client.pem", "keyring-provider": provider})
        assert found["SSL_CLIENT_CERT"] == "/etc/client.pem"
        assert found.get("UV_KEYRING_PROVIDER") == told


class TestPackagesThatDoNotCome:
    @pytest.mark.parametrize(
        ("output", "said"),
        [
            (
                "WARNING: Retrying after connection broken by 'ProxyError('Cannot connect to proxy.', "
                "NewConnectionError('<...>: Failed to establish a new connection: [Errno 111]'))'\n"
                "ERROR: No matching distribution found for tiny==1.0\n",
                "no connection to the package index: check network and proxy",
            ),
            (
                "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.\n"
                "    tiny==1.0 from file:///tiny-1.0-py3-none-any.whl (from -r wheels.lock (line 1)):\n",
                "tiny==1.0 is not the file that the lock was made with",
            ),
            (
                "ERROR: Could not find a version that satisfies the requirement tiny==1.0\n"
                "ERROR: No matching distribution found for tiny==1.0\n",
                "no matching distribution found for tiny==1.0 on your package index: check pip's",
            ),
            (
                "error: Request failed after 1 retry in 1.9s\n  cause: error sending request for url (tiny)\n"
                "  cause: client error (Connect)\n",
                "no connection to the package index: check network and proxy",
            ),
            (
                "error: Failed to download `tiny==1.0`\n  cause: Hash mismatch for `tiny==1.0`\n\n"
                "         Expected:\n           sha256:00\n",
                "tiny==1.0 is not the file that the lock was made with",
            ),
            (
                "error: No solution found when resolving dependencies\n  cause: Because there is no version "
                "of tiny==1.0 and you require tiny==1.0, we can conclude that your requirements fail.\n",
                "no matching distribution found for tiny==1.0 on your package index: check pip's",
            ),
            ("ERROR: [Errno 28] No space left on device\n", "is full: free some space and call again"),
        ],
    )
    def test_what_pip_and_uv_say_becomes_a_cause_and_what_to_do(self, output: str, said: str):
        line = str(failure("the packages could not be installed", output, Path("/p/.setup/on_wheels/a.log")))
        assert said in line
        assert "\n" not in line

    @pytest.mark.slow
    def test_no_network(self, fresh: Path, tmp_path: Path):
        with socket.socket() as unused:
            unused.bind(("127.0.0.1", 0))
            closed = f"http://127.0.0.1:{unused.getsockname()[1]}"
            proxies = dict.fromkeys(
                ("HTTPS_PROXY", "https_proxy", "HTTP_PROXY", "http_proxy", "ALL_PROXY"), closed
            )
            result = spool(
                fresh,
                "demo",
                **proxies,
                NO_PROXY="",
                no_proxy="",
                PIP_CONFIG_FILE=os.devnull,
                PIP_FIND_LINKS="",
                PIP_CACHE_DIR=str(tmp_path / "cache"),
            )
        assert_one_line(result, "no connection to the package index", "check network and proxy")

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("there", "said"),
        [
            (True, ["tiny==1.0", "not the file that the lock was made with"]),
            (False, ["no matching distribution found for tiny==1.0", "pip's configuration"]),
        ],
    )
    def test_a_wrong_hash_and_a_package_that_nobody_has(
        self, fresh: Path, tmp_path: Path, there: bool, said: list[str]
    ):
        if there:
            make_wheel(tmp_path)
        lock = fresh / "requirements" / "wheels.lock"
        (uv,) = UV.findall(lock.read_text("utf-8"))
        lock.write_text(f"{uv}\ntiny==1.0 --hash=sha256:{'0' * 64}\n", "utf-8")
        download = [sys.executable, "-m", "pip", "download", "--no-deps", "-d", tmp_path, uv.split(" ")[0]]
        subprocess.run(download, check=True, capture_output=True)
        given = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(tmp_path), "PIP_CONFIG_FILE": os.devnull}
        assert_one_line(spool(fresh, "demo", **given), *said)


def make_wheel(folder: Path) -> None:
    """A wheel that pip takes."""
    files = {
        "tiny.py": "",
        "tiny-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n",
        "tiny-1.0.dist-info/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(
        f"{name},sha256={base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b'=').decode()},"
        f"{len(text)}\n"
        for name, text in files.items()
    )
    with zipfile.ZipFile(folder / "tiny-1.0-py3-none-any.whl", "w") as wheel:
        for name, text in files.items():
            wheel.writestr(name, text)
        wheel.writestr("tiny-1.0.dist-info/RECORD", record + "tiny-1.0.dist-info/RECORD,,\n")


def test_a_shell_that_sources_the_workspace_finds_its_packages(tmp_path: Path):
    """As `ros2 run` and `ros2 launch` look for them, beside those that it had found before."""
    layout = Layout(ROOT, find_underlay(ROOT, clean_environment()))
    probe = "import os, spool_sim, spool_msgs as m; print(os.environ['AMENT_PREFIX_PATH'], m.__file__)"
    script = f'. "{layout.install}/local_setup.bash" && "{layout.python}" -c "{probe}"'
    environment = clean_environment(AMENT_PREFIX_PATH=str(tmp_path))
    done = subprocess.run(
        ["bash", "-c", script], env=environment, capture_output=True, text=True, check=False
    )
    prefixes, _, module = done.stdout.strip().partition(" ")
    assert prefixes == f"{layout.install}:{tmp_path}", done.stderr
    assert module.startswith(f"{layout.install}/")


@pytest.fixture(scope="module")
def set_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh clone, set up by four calls: the first three are ended in the middle, each in another way.

    Its messages differ from all that were built before.
    """
    folder = tmp_path_factory.mktemp("set_up") / "clone"
    subprocess.run(["git", "clone", "--quiet", ROOT, folder], check=True, capture_output=True)
    with (folder / "ros2_ws/src/spool_msgs/CMakeLists.txt").open("a", encoding="utf-8") as file:
        file.write(f"# {uuid.uuid4()}\n")

    process = start(folder, "test", "--version")
    read_until(process, "making .venv")
    process.send_signal(signal.SIGINT)
    assert_ended_as_interrupted(process)

    process = start(folder, "test", "--version")
    read_until(process, "installing")
    while len(list((folder / ".venv").glob("lib/python3.*/site-packages/*.dist-info"))) < SOME_PACKAGES:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    process.kill()
    process.communicate(timeout=PATIENCE_S)

    process = start(folder, "test", "--version")
    said = read_until(process, "building")
    assert "making .venv" not in said
    process.terminate()
    assert_ended_as_interrupted(process)

    result = spool(folder, "test", "--version")
    assert result.returncode == 0, result.stderr
    assert "installing" not in result.stderr
    assert "building" in result.stderr
    return folder


def assert_ended_as_interrupted(process: subprocess.Popen[str]) -> None:
    _, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert said.endswith("spool: interrupted: call again to go on\n")


def run_inside(folder: Path, code: str, **changes: str) -> str:
    """What a piece of Python prints in the environment that the set-up hands over."""
    probe = folder / "test_probe.py"
    probe.write_text(f"def test_probe():\n    {code}\n", "utf-8")
    result = spool(folder, "test", "-q", "-s", "-p", "no:cacheprovider", str(probe), **changes)
    probe.unlink()
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.mark.slow
@pytest.mark.timeout(900)
class TestSetUp:
    def test_doctor_is_content(self, set_up: Path):
        result = spool(set_up, "doctor")
        assert result.returncode == 0, result.stdout
        assert "packages match" in result.stdout
        assert "rclpy and spool_msgs can be imported" in result.stdout

    def test_messages_and_client_library(self, set_up: Path):
        said = run_inside(set_up, "import rclpy, spool_msgs.msg as m; print(m.HealthEvent.__name__)")
        assert "HealthEvent" in said

    def test_a_changed_setup_py_is_followed_and_needs_no_compiler(self, set_up: Path):
        setup = set_up / "ros2_ws/src/spool_sim/setup.py"
        setup.write_text(setup.read_text("utf-8").replace("simulator =", "other ="), "utf-8")
        result = spool(set_up, "test", "--version")
        assert "[1/1] linking 15 packages ..." in result.stderr
        assert os.access(set_up / "ros2_ws/install/lib/spool_sim/other", os.X_OK)
        assert spool(set_up, "test", "--version").stderr == ""
        subprocess.run(["git", "-C", set_up, "checkout", "--quiet", setup], check=True)

    def test_a_setup_py_that_fails_is_named(self, set_up: Path):
        setup = set_up / "ros2_ws/src/spool_sim/setup.py"
        setup.write_text("import no_such_module\n", "utf-8")
        result = spool(set_up, "test", "--version")
        subprocess.run(["git", "-C", set_up, "checkout", "--quiet", setup], check=True)
        assert_one_line(result, f"{setup} failed", "no_such_module")
        assert spool(set_up, "test", "--version").returncode == 0

    def test_messages_are_built_once(self, set_up: Path):
        """What the first build left serves every clone; a damaged file of it is built again."""
        install = set_up / "ros2_ws/install"
        shutil.rmtree(install)
        result = spool(set_up, "test", "--version")
        assert "[1/1] linking 15 packages ..." in result.stderr
        assert "spool_msgs" not in result.stderr
        archive = max(messages_folder().glob("spool_msgs-*.zip"), key=lambda path: path.stat().st_mtime)
        archive.write_bytes(archive.read_bytes()[:-1000])
        shutil.rmtree(install)
        assert "building spool_msgs ..." in spool(set_up, "test", "--version").stderr
        assert "HealthEvent" in run_inside(
            set_up, "import spool_msgs.msg as m; print(m.HealthEvent.__name__)"
        )

    def test_colcon_builds_the_same_tree(self, set_up: Path, tmp_path: Path):
        """As on a ROS 2 installation, into separate folders; these hold all that the set-up linked."""
        layout = Layout(set_up, Underlay(WHEELS))
        colcon = [layout.python, "-m", "colcon", "--log-base", tmp_path / "log"]
        command = [*colcon, "build", "--merge-install"]
        command += ["--base-paths", set_up / "ros2_ws", "--build-base", tmp_path / "build"]
        command += ["--install-base", tmp_path / "install"]
        add_ons = (path.name for path in (set_up / "ros2_ws/addons").iterdir())
        command += ["--packages-up-to", "spool_bringup", *add_ons]
        command += ["--cmake-args", "-DBUILD_TESTING=OFF", "-DPYTHON_ONLY=ON"]
        environment = base_environment(layout, clean_environment())
        listed = [*colcon, "list", "--names-only", "--base-paths", set_up / "ros2_ws"]
        names = subprocess.run(
            listed, env=environment, capture_output=True, text=True, check=False
        ).stdout.split()
        assert sorted(names) == sorted(path.name for path in layout.packages)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        for package in ("spool_core", "spool_sim", "spool_bringup"):
            ours = files_of(set_up / "ros2_ws/install", package)
            assert ours
            assert ours <= files_of(tmp_path / "install", package)
        probe = "import spool_msgs.msg as m, spool_sim.program; print(m.HealthEvent.__name__, m.__file__)"
        script = f'. "{tmp_path}/install/local_setup.bash" && "{layout.python}" -c "{probe}"'
        said = subprocess.run(
            ["bash", "-c", script], env=environment, capture_output=True, text=True, check=False
        )
        assert f"HealthEvent {tmp_path}" in said.stdout, said.stderr

    def test_python_sources_need_no_build(self, set_up: Path):
        (set_up / "ros2_ws/src/spool_sim/spool_sim/new_module.py").write_text("VALUE = 42\n", "utf-8")
        assert "42" in run_inside(set_up, "import spool_sim.new_module as m; print(m.VALUE)")
        assert spool(set_up, "test", "--version").stderr == ""

    def test_finished_installation_runs_read_only_and_does_no_step_again(self, set_up: Path):
        script = f'{READ_ONLY} && exec "$0/spool" test --version'
        result = in_own_mounts(script, set_up)
        assert result.returncode == 0, result.stderr
        assert result.stderr == ""

    def test_build_failure_names_package_and_log(self, set_up: Path):
        message = set_up / "ros2_ws/src/spool_msgs/msg/Quantity.msg"
        good = message.read_text("utf-8")
        message.write_text(good + "no_such_type value\n", "utf-8")
        result = spool(set_up, "test", "--version")
        message.write_text(good, "utf-8")
        assert result.returncode == 2
        assert result.stderr.splitlines()[-1].startswith("spool: spool_msgs did not build")
        assert "build.log" in result.stderr.splitlines()[-1]
        again = spool(set_up, "test", "--version")
        assert again.returncode == 0, again.stderr
        assert spool(set_up, "test", "--version").stderr == ""

    def test_doctor_sees_a_package_that_is_gone(self, set_up: Path):
        folder = next((set_up / ".venv/lib").glob("python3.*/site-packages/mcap-*.dist-info"))
        folder.rename(folder.with_suffix(".away"))
        result = spool(set_up, "doctor")
        folder.with_suffix(".away").rename(folder)
        assert result.returncode == 1
        assert "mcap missing" in result.stdout

    def test_on_a_sourced_ros(self, set_up: Path, tmp_path: Path):
        """A packaged ROS 2 is not available in a test: wheels sourced from another folder stand in for it."""
        folder = tmp_path / "clone"
        subprocess.run(["git", "clone", "--quiet", set_up, folder], check=True, capture_output=True)
        source = folder / "ros2_ws/src"
        for package in (folder / "ros2_ws").glob("*/spool_*"):
            if package.name not in ("spool_msgs", "spool_monitor", "spool_gap"):
                shutil.rmtree(package)
        for package in ("spool_monitor", "spool_gap"):
            for name in ("__init__", "warm_up"):
                (source / package / package / f"{name}.py").write_text("", "utf-8")
        variables = source_wheels(set_up / ".venv", tmp_path / "ros")
        result = spool(folder, "test", "--version", **variables)
        assert result.returncode == 0, result.stderr
        packages = next((folder / ".setup/on_jazzy/venv/lib").glob("python3.*/site-packages"))
        assert list(packages.glob("ros_*.dist-info")) == []
        assert not (folder / ".venv").exists()
        said = run_inside(
            folder, "import rclpy, spool_msgs.msg as m; print(rclpy.__file__, m.__file__)", **variables
        )
        assert str(tmp_path / "ros") in said
        assert str(folder / ".setup/on_jazzy/install") in said

    def test_moved_folder_is_noticed(self, set_up: Path, tmp_path: Path):
        """A copy with the notes of the original stands in for it."""
        moved = shutil.copytree(
            set_up, tmp_path / "moved", symlinks=True, ignore=shutil.ignore_patterns("site-packages")
        )
        process = start(moved, "test", "--version")
        said = read_until(process, "making .venv")
        process.send_signal(signal.SIGINT)
        assert_ended_as_interrupted(process)
        assert f"the project was moved from {set_up}: setting up again" in said


def messages_folder() -> Path:
    """Where this user's built messages are kept."""
    return wanted_kernel_folder(os.environ).parent / "messages"


def files_of(install: Path, package: str) -> set[str]:
    """What a prefix holds of a package for `ros2 run`, `ros2 launch` and the index, by relative path."""
    folders = (f"lib/{package}", f"share/{package}", "share/ament_index/resource_index/packages")
    found = (path for folder in folders for path in (install / folder).rglob("*") if path.is_file())
    return {
        str(path.relative_to(install))
        for path in found
        if "ament_index" not in path.parts or path.name == package
    }


def source_wheels(venv: Path, folder: Path) -> dict[str, str]:
    """The variables that a sourced ROS 2 sets, for the wheels of an environment alone."""
    folder.mkdir()
    site = next((venv / "lib").glob("python3.*/site-packages"))
    for record in site.glob("ros_*.dist-info/RECORD"):
        for line in record.read_text("utf-8").splitlines():
            name = line.split(",")[0].split("/")[0]
            if name not in ("..", "") and not (folder / name).exists() and (site / name).exists():
                (folder / name).symlink_to(site / name)
    libraries = [str(path) for path in (venv / "lib", *site.glob("ros_*.libs"))]
    return {
        "ROS_DISTRO": "jazzy",
        "AMENT_PREFIX_PATH": str(venv),
        "CMAKE_PREFIX_PATH": str(venv),
        "PYTHONPATH": str(folder),
        "LD_LIBRARY_PATH": os.pathsep.join(libraries),
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }
