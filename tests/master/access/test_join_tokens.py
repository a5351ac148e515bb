"""Join tokens: each is exchanged once for a credential of its process."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import sqlalchemy as sa
from twisted.internet.base import ReactorBase

import rce
from master.access.grants import digest
from master.access.join_tokens import JoinTokens
from master.graph.records import Role
from master.storage import tables as db
from master.storage.store import Store
from rce.control.calls.call import BatchResult
from rce.control.calls.endpoints import Sync
from rce.control.calls.joining import Hello, Welcome
from rce.control.client import ControlClient
from rce.control.connection import Control, Handlers
from rce.control.credential import Credential, stay_joined
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


async def test_process_may_repeat_its_first_join_with_the_credential_that_it_made(processes: JoinTokens) -> None:
    own, other = "c" * 64, "d" * 64
    await processes.allow("west", "robot", "t")
    for secret in ("t", "t", own):
        assert await processes.admit("west", "robot", secret, own) == own
    for process, secret, sent in (("west", "t", other), ("west", "t", ""), ("east", "t", own), ("west", other, "")):
        with pytest.raises(Unauthorized):
            await processes.admit(process, "robot", secret, sent)
    await processes.forget("west")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t", own)


async def test_further_process_of_an_endpoint_joins_by_its_newest_token(processes: JoinTokens) -> None:
    earlier = await processes.invite_sibling("west-robot", 2)
    newest = await processes.invite_sibling("west-robot", 2)
    assert newest.name == "west-robot.2"
    with pytest.raises(Unauthorized):
        await processes.admit("west-robot.2", "robot", earlier.token)
    with pytest.raises(Unauthorized):
        await processes.admit("west-robot.3", "robot", newest.token)
    await processes.admit("west-robot.2", "robot", newest.token)


@pytest.mark.parametrize(("endpoint", "number"), [("west-robot", 1), ("west-robot", 65), ("west-robot.2", 3)])
async def test_endpoint_has_no_other_further_processes(processes: JoinTokens, endpoint: str, number: int) -> None:
    with pytest.raises(InvalidRequest, match=f"{endpoint} has no further process {number}"):
        await processes.invite_sibling(endpoint, number)


async def test_removed_machine_takes_its_further_processes_with_it(processes: JoinTokens) -> None:
    invited = await processes.invite_sibling("west-robot", 2)
    credential = await processes.admit(invited.name, "robot", invited.token)
    waiting = await processes.invite_sibling("west-robot", 3)
    await processes.remove_machine("west")
    for name, secret in ((invited.name, credential), (waiting.name, waiting.token)):
        with pytest.raises(Unauthorized):
            await processes.admit(name, "robot", secret)


async def test_credential_that_can_be_guessed_is_refused(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    with pytest.raises(InvalidRequest, match="at least 32"):
        await processes.admit("west", "robot", "t", "secret")


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


async def test_renewed_token_is_the_only_one_with_which_a_process_may_join(processes: JoinTokens) -> None:
    await processes.allow("ann/brain", "environment", "unused")
    await processes.allow("ann/brain", "environment", "used")
    credential = await processes.admit("ann/brain", "environment", "used")
    await processes.renew("ann/brain", "environment", "new")
    for secret in ("unused", "used", credential):
        with pytest.raises(Unauthorized):
            await processes.admit("ann/brain", "environment", secret)
    await processes.admit("ann/brain", "environment", "new")


async def test_names_are_of_processes_that_have_joined(processes: JoinTokens) -> None:
    roles: dict[str, Role] = {"west": "robot", "m1": "container", "ann/brain": "environment"}
    for name, role in roles.items():
        await processes.allow(name, role, f"token of {name}")
        await processes.admit(name, role, f"token of {name}")
    await processes.allow("east", "robot", "t")
    assert await processes.names() == ["m1", "west"]


# --- invitations of machines ------------------------------------------------------------------------------------------


async def test_invitation_is_redeemed_for_one_key(processes: JoinTokens) -> None:
    await processes.invite("beta", "digest")
    assert not await processes.redeem("gamma", "digest", "key")
    assert not await processes.redeem("beta", "other", "key")
    assert await processes.redeem("beta", "digest", "key")
    assert not await processes.redeem("beta", "digest", "another key")
    assert await processes.redeem("beta", "digest", "key")


async def test_new_invitation_revokes_the_unused_one_of_its_machine(processes: JoinTokens) -> None:
    for machine, invitation in (("beta", "first"), ("gamma", "third"), ("beta", "second")):
        await processes.invite(machine, invitation)
    assert not await processes.redeem("beta", "first", "key")
    assert await processes.redeem("beta", "second", "key")
    assert await processes.redeem("gamma", "third", "key")


async def test_invitation_is_not_a_token_of_a_process(processes: JoinTokens) -> None:
    await processes.invite("beta", digest("secret"))
    for role in ("machine", "container"):
        with pytest.raises(Unauthorized):
            await processes.admit("beta", role, "secret")
    await processes.allow("beta", "container", "token")
    assert not await processes.redeem("beta", digest("token"), "key")


async def test_removed_machine_cannot_use_its_invitation(processes: JoinTokens) -> None:
    await processes.invite("beta", "digest")
    await processes.forget("beta")
    assert not await processes.redeem("beta", "digest", "key")


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


async def test_process_whose_answer_was_lost_joins_again(
    platform: Platform, reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection breaks between the Master's decision and its answer; the process then starts anew."""
    master, joins = platform.master, list[str]()
    await master.join_tokens.allow("west", "robot", "t")
    admit = master.join

    async def cut(hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        result = await admit(hello, address)
        joins.append(hello.token)
        if len(joins) == 1:
            relay.cut()
        return result

    monkeypatch.setattr(master, "join", cut)
    async with Relay(platform) as relay:
        for _ in range(2):
            credential = Credential(tmp_path / "credential", "t")

            def hello(mine: Credential = credential) -> Hello:
                return Hello("robot", "west", mine.secret, rce.__version__, "1", credential=mine.own)

            welcomed = asyncio.Event()

            def keep(welcome: Welcome, mine: Credential = credential, event: asyncio.Event = welcomed) -> None:
                mine.keep(welcome)
                event.set()

            handlers = Handlers()
            handlers.on(Sync, _synced)
            link = ControlClient(reactor, relay.address, hello, handlers, keep)
            running = asyncio.create_task(stay_joined(link, credential))
            await asyncio.wait({running, asyncio.create_task(welcomed.wait())}, return_when=asyncio.FIRST_COMPLETED)
            assert welcomed.is_set()
            running.cancel()
            await asyncio.wait({running})
    assert joins == ["t", "t", (tmp_path / "credential").read_text()]


async def _synced(_: Sync) -> BatchResult:
    return BatchResult()


class Relay:
    """Relay of control connections to a Master."""

    def __init__(self, platform: Platform) -> None:
        self._master = int(platform.address.rpartition(":")[2])
        self._writers: list[asyncio.StreamWriter] = []

    async def __aenter__(self) -> Relay:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.address = f"tcp:127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.cut()

    def cut(self) -> None:
        """Break all connections; what is under way is lost."""
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, onward = await asyncio.open_connection("127.0.0.1", self._master)
        self._writers += [writer, onward]
        await asyncio.gather(_forward(reader, onward), _forward(back, writer))


async def _forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(ConnectionError):
        while data := await reader.read(65536):
            writer.write(data)
    writer.close()
