"""An image that is one small program, for the tests of the engine `docker`."""

from __future__ import annotations

import io
import shutil
import subprocess
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rce import __version__

STAND_IN = "rce-test/stand-in:latest"


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The image's only layer."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler for the stand-in's program: install g++ to run this")
    program = tmp_path_factory.mktemp("stand-in") / "stand-in"
    source = Path(__file__).with_name("stand_in.c")
    subprocess.run(["gcc", "-static", "-Os", "-s", "-o", str(program), str(source)], check=True)
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.add(program, "stand-in")
    return archive.getvalue()


def load(host: str, layer: bytes) -> None:
    """Give a daemon the image."""
    import docker

    api = docker.APIClient(base_url=host, version="auto")
    name, _, tag = STAND_IN.partition(":")
    api.import_image_from_data(layer, repository=name, tag=tag, changes=[f"LABEL rce.version={__version__}"])
    api.close()


@pytest.fixture(scope="session")
def stand_in_image(docker_host: str, stand_in: bytes) -> str:
    load(docker_host, stand_in)
    return STAND_IN


@pytest.fixture(scope="session")
def load_stand_in(stand_in: bytes) -> Callable[[str], None]:
    return lambda host: load(host, stand_in)
