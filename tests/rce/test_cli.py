"""The command line in a light installation, where the servers' and the mapper's libraries are missing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rce.cli import is_program

WITHOUT = """
import sys
for name in ("twisted", "numpy", "rosbags"):
    sys.modules[name] = None
from importlib import util
find_spec = util.find_spec
util.find_spec = lambda name, package=None: None if name == "twisted" else find_spec(name, package)
from rce import cli
sys.argv = ["rce", *sys.argv[1:]]
sys.exit(cli.main())
"""


@pytest.mark.parametrize("words", [["map", "x.clf"], ["up", "--http-port", "0"], ["master"]])
def test_what_is_not_installed_is_named_with_its_remedy(words: list[str], tmp_path: object) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT, *words], capture_output=True, text=True, timeout=30, cwd=str(tmp_path)
    )
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    assert "pip install 'rce[server" in ended.stderr


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
    assert (ended.returncode, ended.stderr) == (1, "")


def test_an_unknown_command_is_named_with_those_that_exist() -> None:
    ended = subprocess.run([sys.executable, "-m", "rce.cli", "mapp"], capture_output=True, text=True, timeout=30)
    assert ended.returncode == 2
    assert "'mapp'" in ended.stderr
    assert "make a map" in ended.stderr


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
    assert (ended.returncode, "pip install 'rce[console]'" in ended.stderr) == (1, True), ended.stderr
    script = subprocess.run(command, input="help\n", capture_output=True, text=True, timeout=30, env=env)
    assert (script.returncode, "env " in script.stdout) == (0, True), script.stderr
