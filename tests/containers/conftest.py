"""An image that is one small program, for the tests of the engine `docker`."""

from __future__ import annotations

import io
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

from rce import __version__

STAND_IN = "rce-test/stand-in:latest"


@pytest.fixture(scope="session")
def stand_in_image(docker_host: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    import docker

    if shutil.which("gcc") is None:
        pytest.skip("no C compiler for the stand-in's program: install g++ to run this")
    program = tmp_path_factory.mktemp("stand-in") / "stand-in"
    source = Path(__file__).with_name("stand_in.c")
    subprocess.run(["gcc", "-static", "-Os", "-s", "-o", str(program), str(source)], check=True)
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.add(program, "stand-in")
    api = docker.APIClient(base_url=docker_host, version="auto")
    api.import_image_from_data(
        archive.getvalue(),
        repository=STAND_IN.partition(":")[0],
        tag="latest",
        changes=[f"LABEL rce.version={__version__}"],
    )
    api.close()
    return STAND_IN
