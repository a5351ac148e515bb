"""User data for cloud-init."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from provisioning import (
    cloudinit,
)
from provisioning.joincode import Code

CODE = Code("rce1-abc", "https://10.0.0.1:8081/", "beta", ("robot", "container"))

AUTHORITY = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"


def test_user_data() -> None:
    text = cloudinit.user_data(CODE, AUTHORITY, "--size 4 --no-images")
    assert text.startswith("#cloud-config\n")
    assert len(text) < 16_384  # limit of clouds
    config = yaml.safe_load(text)
    assert config["hostname"] == "beta"
    files = {file["path"]: file for file in config["write_files"]}
    assert files[cloudinit.CA]["content"] == AUTHORITY
    assert files[cloudinit.CODE] == {"path": cloudinit.CODE, "permissions": "0600", "content": "rce1-abc"}
    (command,) = config["runcmd"]
    assert command[:2] == ["sh", "-ec"]
    assert (
        "--cacert /etc/rce/bootstrap-ca.pem --output /usr/local/src/rce.tar.gz https://10.0.0.1:8081/source"
        in command[2]
    )
    assert "install --role robot,container --name beta --size 4 --no-images --join" in command[2]
    assert steps_of(command[2]) == ["mkdir", "curl", "tar", "cat", "provision", "rm", "provision"]


def steps_of(script: str) -> list[str]:
    """Return the programs that a script runs, in order. They are replaced by stubs."""
    names = ("mkdir", "curl", "tar", "rm", "cat")
    harmless = "".join(f"{name}() {{ echo {name} >&2; }}\n" for name in (*names, "provision"))
    script = script.replace(f"{cloudinit.SOURCE}/provisioning/provision", "provision")
    done = subprocess.run(["sh", "-euc", harmless + script], env={}, check=True, capture_output=True, text=True)
    return done.stderr.split()


@pytest.mark.skipif(shutil.which("cloud-init") is None, reason="needs cloud-init: apt-get install cloud-init")
def test_cloud_init_accepts_user_data(tmp_path: Path) -> None:
    (tmp_path / "user-data").write_text(cloudinit.user_data(CODE, AUTHORITY))
    command = ["cloud-init", "schema", "--config-file", str(tmp_path / "user-data")]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout
