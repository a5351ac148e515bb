"""The command line in a light installation, where the servers' and the mapper's libraries are missing."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rce.cli import is_program

WITHOUT = """
import sys
for name in ("twisted", "numpy", "rosbags"):
    sys.modules[name] = None
from importlib import util
find_spec = util.find_spec
util.find_spec = lambda name, package=None: None if name in ("twisted", "docker") else find_spec(name, package)
from rce import cli
sys.argv = ["rce", *sys.argv[1:]]
sys.exit(cli.main())
"""


@pytest.mark.parametrize("words", [["map", "x.clf"], ["up", "--http-port", "0"], ["master"], ["image", "--help"]])
def test_what_is_not_installed_is_named_with_its_remedy(words: list[str], tmp_path: object) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT, *words], capture_output=True, text=True, timeout=30, cwd=str(tmp_path)
    )
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    assert "pip install '.[server" in ended.stderr


def test_a_list_starts_without_what_it_does_not_need() -> None:
    """Each of these is a good part of the time that a list may take."""
    heavy = ["asyncio", "prompt_toolkit", "rich", "statistics", "websockets"]
    code = f"""
import sys
from rce import cli
sys.argv = ["rce", "env", "list", "--help"]
cli.main()
print([name for name in {heavy} if name in sys.modules], file=sys.stderr)
"""
    ended = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=30)
    assert ended.stderr.strip() == "[]"


def test_who_stops_reading_gets_no_traceback() -> None:
    """`rce map status | head -1`."""
    reads, writes = os.pipe()
    os.close(reads)
    code = """
import sys
from rce import cli
cli.COMMANDS["map"] = ("", lambda _: print("x" * 100_000))
sys.exit(cli.main())
"""
    words = [sys.executable, "-P", "-c", code, "map", "status"]
    ended = subprocess.run(words, stdout=writes, stderr=subprocess.PIPE, text=True, timeout=30)
    os.close(writes)
    assert (ended.returncode, ended.stderr) == (141, "")


def test_an_unknown_command_is_named_with_those_that_exist() -> None:
    ended = subprocess.run([sys.executable, "-m", "rce.cli", "mapp"], capture_output=True, text=True, timeout=30)
    assert ended.returncode == 2
    assert "'mapp'" in ended.stderr
    assert "Make a map" in ended.stderr


@pytest.mark.parametrize(
    ("line", "program"),
    [
        ("robot", True),
        ("robot --master=tcp:a:1", True),
        ("robot list", False),
        ("container --help", True),
        ("container start -n c1", False),
        ("master", True),
        ("user --data-dir=/var/lib/rce/master add ada", True),
        ("user --database sqlite:// list", True),
        ("user add ada", False),
        ("machine --config=/etc/rce/master.toml list", True),
        ("machine list", False),
        ("env list", False),
    ],
)
def test_programs_and_the_console_s_commands_of_one_name(line: str, program: bool) -> None:
    name, *arguments = line.split()
    assert is_program(name, arguments) is program


def test_the_interactive_console_names_what_it_lacks(tmp_path: Path) -> None:
    """On a terminal; a script needs neither library."""
    without = WITHOUT.replace('"twisted", "numpy", "rosbags"', '"prompt_toolkit", "rich"')
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
def test_output_that_finds_no_room_is_told(words: list[str]) -> None:
    with open("/dev/full", "w") as full:
        ended = rce(*words, stdout=full)
    assert (ended.returncode, ended.stderr) == (1, "rce: no space left on device\n")


def test_output_that_is_closed_is_no_defect() -> None:
    ended = subprocess.run(
        ["sh", "-c", f"{sys.executable} -m rce.cli --help >&-"], capture_output=True, text=True, timeout=30
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_terminal_of_another_encoding_shows_what_it_can() -> None:
    env = os.environ | {"PYTHONIOENCODING": "ascii"}
    ended = rce("--help", stdout=subprocess.PIPE, env=env)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "usage: rce COMMAND ?" in ended.stdout


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    env = os.environ | {"XDG_CONFIG_HOME": str(tmp_path), "RCE_URL": "http://127.0.0.1:1/", "RCE_KEY": "rce_x"}
    ended = rce("console", "absent.rce", cwd=tmp_path, env=env)
    assert (ended.returncode, ended.stderr) == (1, "rce: absent.rce: no such file or directory\n")


def test_a_map_that_cannot_be_written_is_not_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ended = rce("map", "--simulate", "--out", "file/map", cwd=tmp_path)
    reason = f"{tmp_path}/file is not a directory: choose another directory with --out"
    assert (ended.returncode, ended.stderr) == (1, f"rce: {reason}\n")


@pytest.mark.parametrize("words", [["map", "submit"], ["map", "cancel"], ["package", "share"]])
def test_the_help_of_a_command_says_what_it_does(words: list[str]) -> None:
    usage, told, *_ = rce(*words, "--help", stdout=subprocess.PIPE).stdout.split("\n\n")
    assert usage.startswith(f"usage: rce {' '.join(words)} ")
    assert told.endswith(".")


def test_ctrl_c_before_anything_is_loaded() -> None:
    program = "import signal, sys; from rce import cli; sys.argv = ['rce', 'up']; cli.COMMANDS['up'] = ('', stop)"
    stop = "def stop(words): signal.raise_signal(signal.SIGINT)\n"
    ended = subprocess.run(
        [sys.executable, "-c", f"{stop}{program}; sys.exit(cli.main())"], capture_output=True, text=True, timeout=30
    )
    assert (ended.returncode, ended.stderr) == (130, "")
