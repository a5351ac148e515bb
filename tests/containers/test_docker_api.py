"""What is said of a Docker that is not there."""

from pathlib import Path

import pytest

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker_api import Asked
from rce.errors import Unavailable


async def test_where_no_docker_answers_is_said_and_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/docker.sock")
    with pytest.raises(Unavailable, match=f"no Docker answers at unix://{tmp_path}/docker.sock: start it, or"):
        await Asked().reach()
