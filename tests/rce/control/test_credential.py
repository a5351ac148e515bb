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


def test_credential_is_stored_for_the_owner_only_before_it_is_sent(tmp_path: Path) -> None:
    file = tmp_path / "credential"
    credential = Credential(file, "token")
    own = credential.own
    assert (credential.secret, file.read_text(), len(own)) == ("token", own, 64)
    assert file.stat().st_mode & 0o777 == 0o600
    assert Credential(file, "token").secret == own  # it may have joined before it was killed
    credential.keep(Welcome(own))
    assert (credential.secret, credential.own) == (own, "")


def test_process_without_a_token_makes_no_credential(tmp_path: Path) -> None:
    credential = Credential(tmp_path / "credential", "")
    assert (credential.secret, credential.own, credential.forget()) == ("", "", False)
    assert list(tmp_path.iterdir()) == []


def test_refused_credential_is_not_used_again(tmp_path: Path) -> None:
    (tmp_path / "credential").write_text("old")
    credential = Credential(tmp_path / "credential", "token")
    assert (credential.secret, credential.own) == ("old", "")
    assert credential.forget()
    assert credential.secret == "token"
    assert credential.own == (tmp_path / "credential").read_text() != "old"
    assert not credential.forget()
    assert list(tmp_path.iterdir()) == []


async def test_token_is_tried_once_if_the_stored_credential_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "credential"
    file.write_text("old")
    client = FakeClient(Credential(file, "token"))
    with pytest.raises(asyncio.CancelledError):
        await stay_joined(cast(ControlClient, client), client.credential)
    assert client.tried == ["old", "token"]


@pytest.mark.parametrize(("stored", "token"), [("old", ""), ("old", "wrong"), ("", "wrong")])
async def test_refusal_without_a_valid_token_is_raised(tmp_path: Path, stored: str, token: str) -> None:
    file = tmp_path / "credential"
    if stored:
        file.write_text(stored)
    client = FakeClient(Credential(file, token))
    with pytest.raises(Unauthorized):
        await stay_joined(cast(ControlClient, client), client.credential)
