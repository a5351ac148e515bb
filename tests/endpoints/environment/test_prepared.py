"""A prepared endpoint takes over the variables, directory and output of its environment."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from endpoints.environment.prepared import join_domain
from endpoints.environment.ros import NODE

CODE = """
from endpoints.environment.prepared import Order, accept
import os
accept(Order({variables!r}, {directory!r}, {output!r}))
print(os.getcwd(), os.environ["FASTDDS_DEFAULT_PROFILES_FILE"], "RCE_TOKEN" in os.environ)
"""


def test_order_is_accepted(tmp_path: Path) -> None:
    directory, output = tmp_path / "d", tmp_path / "log"
    directory.mkdir()
    variables = {
        "RCE_NAME": "ann/brain",
        "RCE_RUN": "0" * 32,
        "RCE_TOKEN": "secret",
        "RCE_MASTER": "tcp:127.0.0.1:1",
        "RCE_DATA_DIR": str(directory),
    }
    code = CODE.format(variables=variables, directory=str(directory), output=str(output))
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ, stdout=subprocess.DEVNULL)
    assert output.read_text() == f"{directory} {directory}/fastdds.xml False\n"


def test_process_ends_with_its_standard_input_and_leaves_no_file(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-m", "endpoints.environment.prepared"],
        input=b"",
        timeout=120,
        check=False,
        capture_output=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.iterdir())


async def test_domain_is_joined_before_the_environment_is_known(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "87")
    monkeypatch.setenv("FASTDDS_DEFAULT_PROFILES_FILE", "")
    ros = join_domain(tmp_path / "fastdds.xml")
    try:
        assert ros.node.get_name() == NODE
        assert os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] == str(tmp_path / "fastdds.xml")
    finally:
        ros.close()
