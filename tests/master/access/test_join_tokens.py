"""Join tokens: each is exchanged once for a credential of its process."""

from __future__ import annotations

from collections import Counter

import pytest
import sqlalchemy as sa

import rce
from master.access.grants import digest
from master.access.join_tokens import JoinTokens
from master.graph.records import Role
from master.storage import tables as db
from master.storage.store import Store
from rce.control.calls.joining import Hello
from rce.errors import InvalidRequest, Unauthorized
from tests.support.master.peers import Peer, Platform


@pytest.fixture
def processes(store: Store) -> JoinTokens:
    return JoinTokens(store)


async def test_token_is_exchanged_once_for_a_credential(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    assert await processes.admit("west", "robot", credential) == credential
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "t")  # as a Master does at each start with this token in its settings
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t")


@pytest.mark.parametrize(
    ("process", "role", "secret"),
    [("east", "robot", "t"), ("west", "container", "t"), ("west", "robot", "u"), ("west", "robot", ""), ("", "", "")],
)
async def test_token_is_for_one_process_and_role(processes: JoinTokens, process: str, role: str, secret: str) -> None:
    await processes.allow("west", "robot", "t")
    with pytest.raises(Unauthorized):
        await processes.admit(process, role, secret)
    assert await processes.admit("west", "robot", "t")


async def test_credential_is_for_one_role(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "container", credential)


async def test_new_token_replaces_the_credential(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    old = await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "u")
    new = await processes.admit("west", "robot", "u")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", old)
    assert await processes.admit("west", "robot", new) == new


async def test_forgotten_process_cannot_join(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "unused")
    await processes.forget("west")
    for secret in (credential, "t", "unused"):
        with pytest.raises(Unauthorized):
            await processes.admit("west", "robot", secret)


async def test_tokens_of_environments_that_are_gone_are_revoked(processes: JoinTokens, store: Store) -> None:
    roles: dict[str, Role] = {"west": "robot", "ann/brain": "environment", "ann/old": "environment"}
    for name, role in roles.items():
        await processes.allow(name, role, f"token of {name}")
        await processes.admit(name, role, f"token of {name}")
        await processes.allow(name, role, f"another of {name}")
    await processes.keep_environments({"ann/brain", "ann/other"})
    assert await rows(store) == {"west": 3, "ann/brain": 3}
    await processes.keep_environments([])
    assert await rows(store) == {"west": 3}


async def rows(store: Store) -> Counter[str]:
    """Return how many rows each process has."""

    def count(connection: sa.Connection) -> Counter[str]:
        tables = (db.tokens, db.credentials)
        return Counter(name for table in tables for name in connection.scalars(sa.select(table.c.process)))

    return await store.run(count)


async def test_forgetting_tells_whether_there_was_anything(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    assert await processes.forget("east", "west")
    assert not await processes.forget("east", "west")


async def test_names_are_of_processes_that_have_joined(processes: JoinTokens) -> None:
    roles: dict[str, Role] = {"west": "robot", "m1": "container", "ann/brain": "environment"}
    for name, role in roles.items():
        await processes.allow(name, role, f"token of {name}")
        await processes.admit(name, role, f"token of {name}")
    await processes.allow("east", "robot", "t")
    assert await processes.names() == ["m1", "west"]


# --- invitations of machines ------------------------------------------------------------------------------------------


async def test_invitation_is_redeemed_once(processes: JoinTokens) -> None:
    await processes.invite("beta", "digest")
    assert not await processes.redeem("gamma", "digest")
    assert not await processes.redeem("beta", "other")
    assert await processes.redeem("beta", "digest")
    assert not await processes.redeem("beta", "digest")


async def test_new_invitation_revokes_the_unused_one_of_its_machine(processes: JoinTokens) -> None:
    for machine, invitation in (("beta", "first"), ("gamma", "third"), ("beta", "second")):
        await processes.invite(machine, invitation)
    assert not await processes.redeem("beta", "first")
    assert await processes.redeem("beta", "second")
    assert await processes.redeem("gamma", "third")


async def test_invitation_is_not_a_token_of_a_process(processes: JoinTokens) -> None:
    await processes.invite("beta", digest("secret"))
    for role in ("machine", "container"):
        with pytest.raises(Unauthorized):
            await processes.admit("beta", role, "secret")
    await processes.allow("beta", "container", "token")
    assert not await processes.redeem("beta", digest("token"))


async def test_removed_machine_cannot_use_its_invitation(processes: JoinTokens) -> None:
    await processes.invite("beta", "digest")
    await processes.forget("beta")
    assert not await processes.redeem("beta", "digest")


# --- over a control connection ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hello", "error"),
    [
        (Hello("robot", "west", "wrong", rce.__version__), Unauthorized),
        (Hello("container", "west", "t", rce.__version__), Unauthorized),
        (Hello("robot", "east", "t", rce.__version__), Unauthorized),
        (Hello("robot", "west", "t", "0.0.0"), InvalidRequest),
    ],
)
async def test_processes_without_valid_token_are_refused(
    platform: Platform, hello: Hello, error: type[Exception]
) -> None:
    await platform.master.join_tokens.allow("west", "robot", "t")
    with pytest.raises(error):
        await Peer(platform, hello).join()
    assert not platform.master.state.joined
