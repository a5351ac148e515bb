"""The command `rce` as a process: exit statuses, output streams, light installations."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from rce.cli.main import DEFAULT_EXTRAS, EXTRAS
from tests.support.paths import ROOT

WITHOUT = """
import sys
for name in ("twisted", "numpy", "rosbags"):
    sys.modules[name] = None
from importlib import util
find_spec = util.find_spec
util.find_spec = lambda name, package=None: None if name in ("twisted", "docker") else find_spec(name, package)
from rce.cli import main as cli
sys.argv = ["rce", *sys.argv[1:]]
sys.exit(cli.main())
"""


@pytest.mark.slow
@pytest.mark.parametrize("words", [["map", "x.clf"], ["up", "--http-port", "0"], ["master"], ["image", "--help"]])
def test_missing_library_is_reported_with_the_extra_to_install(words: list[str], tmp_path: object) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT, *words], capture_output=True, text=True, timeout=30, cwd=str(tmp_path)
    )
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    assert "pip install '.[server" in ended.stderr


MODULES = {"warp-lang": "warp", "pillow": "PIL", "dracopy": "DracoPy"}  # of distributions with other names


def test_extra_of_each_library_is_known() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras: dict[str, list[str]] = project["optional-dependencies"]
    libraries = {extra: {re.split(r"[<>=;[ ]", each)[0].lower() for each in needed} for extra, needed in extras.items()}
    by_default = set().union(*(libraries[extra] for extra in DEFAULT_EXTRAS.split(",")))
    for extra in libraries.keys() - {"dev", "docs"}:
        for library in libraries[extra] - by_default:
            assert EXTRAS[MODULES.get(library, library)] == extra


def test_help_of_map_needs_no_mapping_library() -> None:
    code = WITHOUT.replace('"rosbags")', '"rosbags", "numba", "scipy", "cv2")')
    ended = subprocess.run([sys.executable, "-c", code, "map", "--help"], capture_output=True, text=True, timeout=30)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith("usage: rce map ")


def test_list_command_does_not_import_slow_modules() -> None:
    """Importing any of these takes a good part of the time that a list command may take."""
    slow = ["asyncio", "numpy", "prompt_toolkit", "statistics", "twisted", "websockets"]
    code = f"""
import sys
from rce.cli import main as cli
sys.argv = ["rce", "env", "list", "--help"]
cli.main()
print([name for name in {slow} if name in sys.modules], file=sys.stderr)
"""
    ended = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=30)
    assert ended.stderr.strip() == "[]"


def test_closed_pipe_ends_a_command_with_status_141() -> None:
    """As in `rce audit | head`."""
    reads, writes = os.pipe()
    os.close(reads)
    code = """
import sys
from rce.cli import main as cli, table
table.COMMANDS["map status"] = table.COMMANDS["map status"]._replace(run=lambda session, args: print("x" * 100_000))
sys.exit(cli.main())
"""
    words = [sys.executable, "-P", "-c", code, "map", "status"]
    ended = subprocess.run(words, stdout=writes, stderr=subprocess.PIPE, text=True, timeout=30)
    os.close(writes)
    assert (ended.returncode, ended.stderr) == (141, "")


def test_unknown_command_is_answered_with_the_list_of_commands() -> None:
    ended = subprocess.run([sys.executable, "-m", "rce.cli", "xyzzy"], capture_output=True, text=True, timeout=30)
    assert ended.returncode == 2
    assert "'xyzzy'" in ended.stderr
    assert "Make a map" in ended.stderr


def test_interactive_console_reports_missing_libraries(tmp_path: Path) -> None:
    """A script does not need them."""
    without = WITHOUT.replace('"twisted", "numpy", "rosbags"', '"prompt_toolkit",')
    env = os.environ | {"XDG_CONFIG_HOME": str(tmp_path)}
    master, slave = os.openpty()
    command = [sys.executable, "-c", without, "console"]
    ended = subprocess.run(command, stdin=slave, capture_output=True, text=True, timeout=30, env=env)
    os.close(master)
    os.close(slave)
    assert (ended.returncode, "pip install '.[console]'" in ended.stderr) == (1, True), ended.stderr
    script = subprocess.run(command, input="help\n", capture_output=True, text=True, timeout=30, env=env)
    assert (script.returncode, "env " in script.stdout) == (0, True), script.stderr


def rce(*words: str, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rce.cli", *words]
    return subprocess.run(command, **{"stderr": subprocess.PIPE, "text": True, "timeout": 30} | options)


@pytest.mark.parametrize("words", [["--help"], ["help"]])
def test_full_disk_is_reported(words: list[str]) -> None:
    with open("/dev/full", "w") as full:
        ended = rce(*words, stdout=full)
    assert (ended.returncode, ended.stderr) == (1, "rce: no space left on device\n")


def test_closed_standard_output_is_tolerated() -> None:
    ended = subprocess.run(
        ["sh", "-c", f"{sys.executable} -m rce.cli --help >&-"], capture_output=True, text=True, timeout=30
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_terminal_without_unicode_shows_question_marks() -> None:
    env = os.environ | {"PYTHONIOENCODING": "ascii"}
    ended = rce("--help", stdout=subprocess.PIPE, env=env)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "usage: rce COMMAND ?" in ended.stdout


def test_missing_script_is_reported_with_its_name(tmp_path: Path) -> None:
    env = os.environ | {"XDG_CONFIG_HOME": str(tmp_path), "RCE_URL": "http://127.0.0.1:1/", "RCE_KEY": "rce_x"}
    ended = rce("console", "absent.rce", cwd=tmp_path, env=env)
    assert (ended.returncode, ended.stderr) == (1, "rce: absent.rce: no such file or directory\n")


@pytest.mark.slow
def test_unusable_output_directory_is_reported_before_mapping(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ended = rce("map", "--simulate", "--out", "file/map", cwd=tmp_path)
    reason = f"{tmp_path}/file is not a directory: choose another directory with --out"
    assert (ended.returncode, ended.stderr) == (1, f"rce: {reason}\n")


@pytest.mark.parametrize("words", [["map", "submit"], ["map", "cancel"], ["package", "share"]])
def test_help_of_a_command_starts_with_usage_and_a_sentence(words: list[str]) -> None:
    usage, description, *_ = rce(*words, "--help", stdout=subprocess.PIPE).stdout.split("\n\n")
    assert usage.startswith(f"usage: rce {' '.join(words)} ")
    assert description.endswith(".")


def test_ctrl_c_during_imports_ends_with_status_130() -> None:
    code = """
import signal, sys
from rce.cli import main as cli
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "rce.errors":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
sys.argv = ["rce", "up"]
sys.exit(cli.main())
"""
    ended = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=30)
    assert (ended.returncode, ended.stderr) == (130, "")


def test_interrupted_command_ends_with_status_130() -> None:
    code = """
import signal, sys
from rce.cli import main as cli, table
def interrupt(arguments):
    signal.raise_signal(signal.SIGINT)
table.PROGRAMS["up"] = table.PROGRAMS["up"]._replace(run=interrupt)
sys.argv = ["rce", "up"]
sys.exit(cli.main())
"""
    ended = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=30)
    assert (ended.returncode, ended.stderr) == (130, "")
