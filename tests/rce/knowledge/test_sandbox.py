"""The program that reads texts and answers queries: its limits."""

from __future__ import annotations

import os
import resource
import signal
import time
from pathlib import Path

import pyoxigraph
import pytest

from rce.errors import InvalidRequest
from rce.knowledge import sandbox
from rce.knowledge.messages import (
    HEADER,
    Answered,
    Document,
    Drop,
    Evaluate,
    Failed,
    Load,
    Read,
    Readings,
    Reply,
    reply,
)
from tests.support.knowledge import CUP

MEMORY = 512 * 1024**2
COUNT = "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }"
GRAPH = "https://rce.invalid/knowledge/object/cup.blue"


def done(packed: bytes | None) -> Reply:
    assert packed is not None
    assert HEADER.unpack(packed[: HEADER.size])[0] == len(packed) - HEADER.size
    return reply(packed[HEADER.size :])


@pytest.fixture
def store() -> pyoxigraph.Store:
    return pyoxigraph.Store()


def count(store: pyoxigraph.Store) -> str | None:
    answer = done(sandbox.execute(store, Evaluate(COUNT, 30, MEMORY, 10)))
    assert isinstance(answer, Answered), answer
    return answer.result.rows[0][0]


def test_graphs_are_loaded_replaced_and_dropped(store: pyoxigraph.Store) -> None:
    triple = b"<http://a> <http://b> <http://c> .\n"
    assert sandbox.execute(store, Load(GRAPH, triple + triple.replace(b"c", b"d"))) is None
    assert sandbox.execute(store, Load(GRAPH + "x", triple)) is None
    assert (count(store) or "").startswith('"2"'), "the default graph is the union"
    sandbox.execute(store, Load(GRAPH, triple))
    assert (count(store) or "").startswith('"1"')
    for graph in (GRAPH, GRAPH + "x"):
        assert sandbox.execute(store, Drop(graph)) is None
    assert (count(store) or "").startswith('"0"')


def test_each_text_is_read_for_itself(store: pyoxigraph.Store) -> None:
    documents = [Document(GRAPH, CUP), Document(GRAPH, "<a"), Document(GRAPH, CUP)]
    answer = done(sandbox.execute(store, Read(documents, 30, MEMORY)))
    assert isinstance(answer, Readings)
    assert [(each.count, each.refused is None) for each in answer.results] == [(5, True), (0, False), (5, True)]


def test_work_that_would_run_for_ever_is_killed() -> None:
    began = time.monotonic()
    answer = done(sandbox.in_fork(lambda: time.sleep(1000) or Readings([]), 0.2, MEMORY))
    assert isinstance(answer, Failed)
    assert answer.error.code == "timed_out"
    assert time.monotonic() - began < 100


def test_work_that_needs_too_much_memory_ends() -> None:
    # More than the fork has at its start: it may use memory that it frees meanwhile, such as garbage of other tests.
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    too_large = used + 1024**3
    answer = done(sandbox.in_fork(lambda: Readings([len(bytearray(too_large))]), 30, 64 * 1024**2))  # type: ignore[list-item]
    assert isinstance(answer, Failed)
    assert (answer.error.code, answer.error.message) == (
        "limit_exceeded",
        "stopped: it needs more than 64 MiB of memory",
    )


def test_work_that_dies_is_a_failure() -> None:
    answer = done(sandbox.in_fork(lambda: os.kill(os.getpid(), signal.SIGKILL), 30, MEMORY))
    assert isinstance(answer, Failed)


def test_refusal_of_the_work_is_its_answer() -> None:
    def refuse() -> Reply:
        raise InvalidRequest("no", field="query")

    answer = done(sandbox.in_fork(refuse, 30, MEMORY))
    assert isinstance(answer, Failed)
    assert (answer.error.code, answer.error.field) == ("invalid_request", "query")


def test_work_that_the_kernel_stops_for_its_cpu_time_has_timed_out() -> None:
    def work() -> Reply:
        os.kill(os.getpid(), signal.SIGXCPU)
        raise AssertionError

    answer = done(sandbox.in_fork(work, 30, MEMORY))
    assert isinstance(answer, Failed)
    assert "stopped after 30 s" in answer.error.message
