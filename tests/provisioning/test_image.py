"""Build context of the images."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from provisioning import image
from rce.errors import StartFailed


@pytest.fixture(autouse=True)
def no_certificates(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in image.CERTIFICATES:
        monkeypatch.delenv(name, raising=False)


def context() -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(image.make_context())) as archive:
        files = [member for member in archive.getmembers() if member.isfile()]
        assert {(member.mtime, member.uid) for member in files} == {(0, 0)}
        return {member.name: _read(archive, member) for member in files}


def _read(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = archive.extractfile(member)
    assert file is not None
    return file.read()


def test_context_contains_code_of_environments_only() -> None:
    names = set(context())
    assert {"images/base/Dockerfile", "images/mapping/Dockerfile", "images/mapping/start"} <= names
    assert {"code/endpoints/environment/__main__.py", "code/containers/nodes/rce_demo/echo.py"} <= names
    assert not [name for name in names if "__pycache__" in name or name.startswith("code/master")]
    assert not [name for name in names if name.startswith("code/containers/") and "/nodes/" not in name][1:]


def test_context_has_the_programs_of_a_platform_on_kubernetes() -> None:
    names = set(context())
    assert {"server/master/__main__.py", "server/endpoints/robot/__main__.py", "server/containers/__main__.py"} <= names
    assert "kubernetes_asyncio" in context()["server.txt"].decode()


def test_context_is_reproducible() -> None:
    assert image.make_context() == image.make_context()


def test_requirements_are_those_of_pyproject() -> None:
    lines = context()["base.txt"].decode().splitlines()
    assert lines[0] == "-c constraints.txt"
    assert "ros-rclpy" in lines
    assert any(line.startswith("msgspec") for line in lines)
    assert not any(line.startswith(("docker", "opencv", "SQLAlchemy")) for line in lines)


def test_ca_certificates_of_the_host_are_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "certificates/ca-certificates.crt" not in context()
    (tmp_path / "ca.pem").write_text("a company's own")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))
    assert context()["certificates/ca-certificates.crt"] == b"a company's own"


def test_failed_build_shows_its_last_lines() -> None:
    output = iter([{"stream": "Step 1\n"}, {"stream": "no such package\n"}, {"error": "returned 1"}])
    with pytest.raises(StartFailed, match=r"no such package\n+rce/base was not built: returned 1"):
        image._follow("rce/base", output)
