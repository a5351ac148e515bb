"""Connecting to a Docker daemon."""

from pathlib import Path

import pytest

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker.api import AsyncDocker
from rce.errors import Unavailable


async def test_unreachable_daemon_is_named_with_a_hint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/docker.sock")
    with pytest.raises(
        Unavailable, match=f"no Docker answers at unix://{tmp_path}/docker.sock: start it, set DOCKER_HOST"
    ):
        await AsyncDocker().connect_api()
