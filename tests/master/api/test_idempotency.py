"""Requests with an Idempotency-Key take effect once."""

from __future__ import annotations

import asyncio

import pytest

from master.api import idempotency
from master.api.idempotency import LIFETIME, IdempotencyCache
from master.api.request import Answer, Call
from rce.api.roles import Principal
from rce.errors import InternalError, NotFound, RceError
from rce.web.problems import KeyReused
from tests.support.hand_turned import HandTurnedLoop
from tests.support.master.calls import make_call
from tests.support.master.served import Served

ANN = Principal("ann", "user")
BRAIN = {"containerTag": "brain"}


class Handler:
    """Counts its calls, and answers with their number; it fails as long as there are `errors`."""

    def __init__(self, *errors: BaseException) -> None:
        self.calls = 0
        self.errors = list(errors)
        self.begun = asyncio.Event()
        self.may_answer = asyncio.Event()
        self.may_answer.set()

    async def __call__(self, call: Call) -> Answer:
        self.calls += 1
        self.begun.set()
        await self.may_answer.wait()
        if self.errors:
            raise self.errors.pop(0)
        return Answer(status=200 + self.calls)


def post(key: str = "k", principal: Principal | None = ANN, path: str = "/a", content: bytes = b"") -> Call:
    return make_call(principal, "POST", path, content, headers={"Idempotency-Key": key})


async def test_request_without_a_key_is_handled_each_time() -> None:
    cache, handler = IdempotencyCache(), Handler()
    for _ in range(2):
        await cache.answer(make_call(ANN, "POST"), handler)
    await cache.answer(post(principal=None), handler)
    await cache.answer(post(principal=None), handler)
    assert handler.calls == 4


async def test_repeated_request_gets_the_first_answer() -> None:
    cache, handler = IdempotencyCache(), Handler()
    assert [(await cache.answer(post(), handler)).status for _ in range(2)] == [201, 201]
    assert (await cache.answer(post("other"), handler)).status == 202


async def test_key_is_for_one_request() -> None:
    cache, handler = IdempotencyCache(), Handler()
    await cache.answer(post(), handler)
    for other in (post(path="/b"), post(path="/a?user=bob"), post(content=b"{}")):
        with pytest.raises(KeyReused):
            await cache.answer(other, handler)
    assert handler.calls == 1


async def test_later_user_of_the_same_name_gets_no_answer_of_the_former_one() -> None:
    removals: dict[str, float] = {}
    cache, handler = IdempotencyCache(lambda: removals), Handler()
    assert (await cache.answer(post(), handler)).status == 201
    removals["ann"] = 1.0
    assert [(await cache.answer(post(), handler)).status for _ in range(2)] == [202, 202]


async def test_key_is_of_one_credential() -> None:
    cache, handler = IdempotencyCache(), Handler()
    for principal in (ANN, Principal("bob", "user"), Principal("ann", "user", "k1"), Principal("ann", "user", "k2")):
        await cache.answer(post(principal=principal), handler)
    assert handler.calls == 4


@pytest.mark.parametrize(
    ("error", "calls"),
    [(NotFound("no"), 1), (InternalError("oh"), 2), (RceError("oh"), 2), (ZeroDivisionError(), 2)],
)
async def test_failures_of_the_server_are_not_kept(error: Exception, calls: int) -> None:
    cache, handler = IdempotencyCache(), Handler(error)
    with pytest.raises(type(error)):
        await cache.answer(post(), handler)
    if calls == 1:
        with pytest.raises(type(error)):
            await cache.answer(post(), handler)
    else:
        assert (await cache.answer(post(), handler)).status == 202
    assert handler.calls == calls


async def test_request_goes_on_when_its_client_disconnects() -> None:
    cache, handler = IdempotencyCache(), Handler()
    handler.may_answer.clear()
    first, second = (asyncio.ensure_future(cache.answer(post(), handler)) for _ in range(2))
    await asyncio.wait_for(handler.begun.wait(), 20)
    first.cancel()
    await asyncio.wait([first])
    handler.may_answer.set()
    assert (await second).status == 201
    assert handler.calls == 1


async def test_number_of_keys_of_a_credential_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(idempotency, "MAX_KEYS", 2)
    cache, handler = IdempotencyCache(), Handler()
    for key in ("a", "b", "c"):
        await cache.answer(post(key), handler)
    assert (await cache.answer(post("c"), handler)).status == 203
    assert (await cache.answer(post("a"), handler)).status == 204  # the oldest was evicted


def test_answers_are_kept_for_some_hours(hand: HandTurnedLoop) -> None:
    cache, handler = IdempotencyCache(), Handler()

    def status() -> int:
        return hand.begin(cache.answer(post(), handler)).result().status

    assert status() == 201
    hand.turn(LIFETIME)
    assert status() == 201
    hand.turn(1)
    assert status() == 202


async def test_same_idempotency_key_gets_the_same_answer(served: Served) -> None:
    key = {"Idempotency-Key": "k1"}
    first, second = await asyncio.gather(*(served.ask("POST", "/environments", body=BRAIN, **key) for _ in range(2)))
    assert first.status == second.status == 201
    assert first.body == second.body
    assert (await served.ask("POST", "/environments", body=BRAIN)).status == 409
    other = await served.ask("POST", "/environments", body={"containerTag": "x"}, **key)
    assert (other.status, other.body["code"]) == (409, "key_reused")
    assert (await served.ask("POST", "/environments", "bob", BRAIN, **key)).body["user"] == "bob"


async def test_server_failure_can_be_retried_with_the_same_key(served: Served) -> None:
    await served.leave("m1")
    await served.master.join_tokens.forget("m1")
    served.master.state.forget("m1")
    key = {"Idempotency-Key": "k1"}
    assert (await served.ask("POST", "/environments", body=BRAIN, **key)).status == 503
    await served.process("container", "m2", capacity=10)
    assert (await served.ask("POST", "/environments", body=BRAIN, **key)).status == 201
