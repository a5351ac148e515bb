"""Storage of the credential with which a process joins the Master."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import cast

import pytest

from rce.control.calls.joining import Welcome
from rce.control.client import ControlClient
from rce.control.credential import Credential, stay_joined
from rce.errors import Unauthorized


class FakeClient:
    """Control client that the Master refuses while `secret` is not the join token."""

    def __init__(self, credential: Credential) -> None:
        self.credential = credential
        self.tried: list[str] = []

    async def run(self) -> None:
        self.tried.append(self.credential.secret)
        if self.credential.secret != "token":
            raise Unauthorized("the credential was revoked")
        raise asyncio.CancelledError


def test_credential_replaces_the_token_and_is_stored_for_the_owner_only(tmp_path: Path) -> None:
    file = tmp_path / "credential"
    credential = Credential(file, "token")
    assert credential.secret == "token"
    credential.keep(Welcome("secret"))
    assert credential.secret == "secret"
    assert Credential(file, "").secret == "secret"
    assert file.stat().st_mode & 0o777 == 0o600


async def test_token_is_tried_once_if_the_stored_credential_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "credential"
    file.write_text("old")
    client = FakeClient(Credential(file, "token"))
    with pytest.raises(asyncio.CancelledError):
        await stay_joined(cast(ControlClient, client), client.credential)
    assert client.tried == ["old", "token"]
    assert not file.exists()


@pytest.mark.parametrize(("stored", "token"), [("old", ""), ("old", "wrong"), ("", "wrong")])
async def test_refusal_without_a_valid_token_is_raised(tmp_path: Path, stored: str, token: str) -> None:
    file = tmp_path / "credential"
    if stored:
        file.write_text(stored)
    client = FakeClient(Credential(file, token))
    with pytest.raises(Unauthorized):
        await stay_joined(cast(ControlClient, client), client.credential)
