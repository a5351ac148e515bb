"""Programs of services: their settings, and how they start."""

from __future__ import annotations

import ssl
import stat
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.control.connection import Handlers
from rce.errors import InvalidRequest
from rce.process import settings
from rce.services import program
from rce.services.program import Port, ServiceSettings


class Settings(ServiceSettings):
    """Service of a test."""

    port: Port = 9060


class Service:
    """Service that notes where it listens."""

    def __init__(self) -> None:
        self.listens: list[tuple[str, int, ssl.SSLContext | None]] = []

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None) -> int:
        self.listens.append((host, port, tls))
        return 9061

    def handlers(self) -> Handlers:
        return Handlers()

    async def stop(self) -> None: ...


def test_service_has_the_settings_of_all_and_its_own_port(tmp_path: Path) -> None:
    options = settings.load(Settings, "rce test", [f"--data-dir={tmp_path}", "--public-url=https://maps.example/"])
    assert (options.host, options.port, options.public_url) == ("127.0.0.1", 9060, "https://maps.example/")
    with pytest.raises(InvalidRequest, match="port"):
        settings.load(Settings, "rce test", [f"--data-dir={tmp_path}", "--port=70000"])


def test_directory_is_made_for_this_user_only(tmp_path: Path) -> None:
    directory = Settings(tmp_path / "maps" / "data").directory()
    assert stat.S_IMODE(directory.stat().st_mode) == 0o700


async def test_service_listens_before_it_joins(reactor: ReactorBase, tmp_path: Path) -> None:
    service = Service()
    link, credential = await program.start(reactor, Settings(tmp_path, token="once"), "test", service)
    assert service.listens == [("127.0.0.1", 9060, None)]
    assert not link.connected
    assert credential.secret == "once"


async def test_certificate_that_cannot_be_used_is_refused(reactor: ReactorBase, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"missing\.pem"):
        await program.start(reactor, Settings(tmp_path, certificate=str(tmp_path / "missing.pem")), "test", Service())
