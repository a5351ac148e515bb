"""Authentication of the service's clients: credentials, the cache, and what invalidates it."""

from __future__ import annotations

import asyncio
import base64
import hashlib
from typing import Any

import pytest
from twisted.internet.task import Clock

from rce.control.calls.call import Call
from rce.control.calls.services import Authenticate, Identity, RecordAction
from rce.errors import Unauthorized, Unavailable
from rce.services import authentication
from rce.services.authentication import CACHE_TIME, Authenticator, Client, credentials
from tests.support.map_service import FakeMaster

ANN = {"Authorization": "Bearer rce_ann"}
BOB = {"Authorization": "Bearer rce_bob"}
SECRET_HASH = hashlib.sha256(b"secret").hexdigest()


class SlowMaster(FakeMaster):
    """Master whose answers wait until `release`."""

    def __init__(self) -> None:
        super().__init__()
        self.release = asyncio.Event()
        self.asked = asyncio.Event()

    async def call(self, call: Call[Any], wait: float = 10.0) -> Any:
        answer = await super().call(call, wait)
        self.asked.set()
        await self.release.wait()
        return answer


def encoded(text: bytes) -> str:
    return base64.b64encode(text).decode()


@pytest.fixture
def master() -> FakeMaster:
    return FakeMaster()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def authenticator(master: FakeMaster, clock: Clock) -> Authenticator:
    return Authenticator(lambda: master, clock.seconds)


@pytest.mark.parametrize(
    ("header", "query", "expected"),
    [
        ("Bearer rce_ann", {}, ("", "rce_ann")),
        ("bearer  rce_ann ", {"userID": "ann"}, ("ann", "rce_ann")),
        (f"Basic {encoded(b'ann:rce_ann')}", {}, ("ann", "rce_ann")),
        (f"Basic {encoded(b'ann:secret')}", {}, ("ann", SECRET_HASH)),
        (f"Basic {encoded(b'ann:a:b')}", {}, ("ann", hashlib.sha256(b"a:b").hexdigest())),
        ("", {"key": "rce_ann"}, ("", "rce_ann")),
        ("", {"userID": "ann", "key": "rce_ann", "password": "x"}, ("ann", "rce_ann")),
        ("", {"userID": "ann", "password": SECRET_HASH}, ("ann", SECRET_HASH)),
        ("Bearer", {"key": "rce_ann"}, ("", "rce_ann")),
    ],
)
def test_credentials_are_read_from_header_or_query(
    header: str, query: dict[str, str], expected: tuple[str, str]
) -> None:
    assert credentials({"Authorization": header} if header else {}, query) == expected


@pytest.mark.parametrize(
    ("header", "query"),
    [
        ("", {}),
        ("", {"password": SECRET_HASH}),
        ("", {"userID": "ann"}),
        ("Digest abc", {}),
        ("Basic %%%", {}),
        ("Basic é", {}),
        (f"Basic {encoded(bytes([0xFF]))}", {}),
    ],
)
def test_missing_or_malformed_credentials_are_refused(header: str, query: dict[str, str]) -> None:
    with pytest.raises(Unauthorized):
        credentials({"Authorization": header} if header else {}, query)


async def test_client_has_the_identity_that_the_master_knows(authenticator: Authenticator, master: FakeMaster) -> None:
    client = await authenticator.authenticate(ANN, {}, "job.read", "10.0.0.7")
    assert client == Client("ann", "rce_ann", Identity("ann", "robot"))
    assert master.calls == [Authenticate("", "rce_ann", "job.read", "10.0.0.7")]


async def test_answer_is_cached_for_a_while(authenticator: Authenticator, master: FakeMaster, clock: Clock) -> None:
    await authenticator.authenticate(ANN, {})
    clock.advance(CACHE_TIME - 1)
    await authenticator.authenticate(ANN, {})
    assert len(master.calls) == 1
    clock.advance(1)
    await authenticator.authenticate(ANN, {})
    assert len(master.calls) == 2


async def test_permission_for_one_operation_is_not_used_for_another(
    authenticator: Authenticator, master: FakeMaster
) -> None:
    await authenticator.authenticate(ANN, {}, "job.read")
    await authenticator.authenticate(ANN, {}, "job.submit")
    assert [call.operation for call in master.calls if isinstance(call, Authenticate)] == ["job.read", "job.submit"]


async def test_refusal_is_not_cached(authenticator: Authenticator, master: FakeMaster) -> None:
    master.failure = Unavailable("no connection")
    assert not authenticator.reachable
    with pytest.raises(Unavailable):
        await authenticator.authenticate(ANN, {})
    master.failure = None
    assert authenticator.reachable
    assert (await authenticator.authenticate(ANN, {})).user == "ann"


async def test_simultaneous_requests_share_one_call() -> None:
    master = SlowMaster()
    authenticator = Authenticator(lambda: master)
    first, *others = (asyncio.ensure_future(authenticator.authenticate(ANN, {})) for _ in range(3))
    await master.asked.wait()
    first.cancel()  # this client has disconnected
    master.release.set()
    assert [client.user for client in await asyncio.gather(*others)] == ["ann", "ann"]
    assert len(master.calls) == 1


async def test_cache_is_bounded(
    authenticator: Authenticator, master: FakeMaster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(authentication, "CACHE_SIZE", 1)
    for headers in (ANN, BOB, ANN):
        await authenticator.authenticate(headers, {})
    assert len(master.calls) == 3


async def test_invalidated_user_is_authenticated_again(authenticator: Authenticator, master: FakeMaster) -> None:
    for headers in (ANN, BOB):
        await authenticator.authenticate(headers, {})
    authenticator.invalidate("ann")
    for headers in (BOB, ANN):
        await authenticator.authenticate(headers, {})
    assert [call.secret for call in master.calls if isinstance(call, Authenticate)] == ["rce_ann", "rce_bob", "rce_ann"]


async def test_answer_older_than_an_invalidation_is_not_cached() -> None:
    """A user that is removed while the answer is on its way would be authenticated for the time of the cache."""
    master = SlowMaster()
    authenticator = Authenticator(lambda: master)
    asking = asyncio.ensure_future(authenticator.authenticate(ANN, {}))
    await master.asked.wait()
    authenticator.invalidate("ann")
    master.release.set()
    await asking
    master.failure = Unauthorized("the user is removed")
    with pytest.raises(Unauthorized):
        await authenticator.authenticate(ANN, {})


async def test_waiting_responses_learn_of_an_invalidation(authenticator: Authenticator) -> None:
    first, second, other = (authenticator.invalidation(user) for user in ("ann", "ann", "bob"))
    authenticator.invalidate("ann")
    assert (first.done(), second.done(), other.done()) == (True, True, False)
    assert not authenticator.invalidation("ann").done(), "the next invalidation"


@pytest.mark.parametrize("failure", [None, Unavailable("no connection")])
async def test_operation_is_recorded_without_delaying_the_client(
    authenticator: Authenticator, master: FakeMaster, failure: Unavailable | None
) -> None:
    client = await authenticator.authenticate(ANN, {})
    master.failure = failure
    authenticator.record(client, "job.cancel", "ann/1", "ok", "10.0.0.7")
    assert len(master.calls) == 1
    await asyncio.gather(*authenticator._records)
    assert master.calls[1] == RecordAction(client.identity, "job.cancel", "ann/1", "ok", "10.0.0.7")


async def test_grant_gives_keys_until_it_is_revoked(authenticator: Authenticator) -> None:
    grant = await authenticator.create_grant("ann", "rce_ann")
    key = await authenticator.issue_key(grant, 60.0)
    assert (key.user, key.key) == ("ann", "rce_lent_1")
    await authenticator.revoke_grant(grant)
    with pytest.raises(Unauthorized):
        await authenticator.issue_key(grant, 60.0)
