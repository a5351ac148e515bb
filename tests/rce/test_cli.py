"""The command line in a light installation, where the servers' and the mapper's libraries are missing."""

import subprocess
import sys

import pytest

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


def test_an_unknown_command_is_named_with_those_that_exist() -> None:
    ended = subprocess.run([sys.executable, "-m", "rce.cli", "mapp"], capture_output=True, text=True, timeout=30)
    assert ended.returncode == 2
    assert "'mapp'" in ended.stderr
    assert "make a map" in ended.stderr
