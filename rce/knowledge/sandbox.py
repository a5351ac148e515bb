"""`python -P -m rce.knowledge.sandbox`: reads texts and answers queries, each in a fork with limits.

The program keeps the graphs that its user may read in memory. A fork has them at once and shares the memory, so that
work which exceeds its limits is killed and nothing has to be loaded again. Commands come by standard input, replies go
to standard output (`rce.knowledge.messages`); the program ends with its input. It has a single thread.
"""

from __future__ import annotations

import contextlib
import math
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import pyoxigraph

from rce.errors import LimitExceeded, RceError, TimedOut
from rce.knowledge import evaluation, graphs, reading
from rce.knowledge.messages import (
    HEADER,
    Answered,
    Command,
    Document,
    Drop,
    Evaluate,
    Failed,
    Load,
    Read,
    Reading,
    Readings,
    Reply,
    command,
    pack,
)

PIECE = 1024 * 1024


def run(commands: BinaryIO, replies: BinaryIO) -> None:
    """Execute commands until their end."""
    store = pyoxigraph.Store()
    evaluation.check_query("ASK {}")  # the parser prepares itself at its first use: once, not in each fork
    while head := commands.read(HEADER.size):
        answer = execute(store, command(commands.read(HEADER.unpack(head)[0])))
        if answer is not None:
            replies.write(answer)
            replies.flush()


def execute(store: pyoxigraph.Store, asked: Command) -> bytes | None:
    """Execute a command; return its packed reply."""
    match asked:
        case Load(graph, triples):
            graphs.set_graph(store, graph, triples)
        case Drop(graph):
            graphs.drop_graph(store, graph)
        case Read(documents, seconds, memory):
            return in_fork(lambda: Readings([read(document) for document in documents]), seconds, memory)
        case Evaluate(query, seconds, memory, rows):
            return in_fork(lambda: Answered(evaluation.evaluate(store, query, rows)), seconds, memory)
    return None


def read(document: Document) -> Reading:
    """Read a text; what is wrong with it is in the reading."""
    try:
        return reading.read(document.base, document.text)
    except RceError as error:
        return Reading(refused=error.info)


def in_fork(work: Callable[[], Reply], seconds: float, memory: int) -> bytes:
    """Do work in a fork and return its packed reply, which says so if the work exceeded its limits.

    Args:
        work: The work.
        seconds: Time until the fork is killed.
        memory: Bytes that it may allocate.
    """
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        _work(work, seconds, memory, sending)
    os.close(sending)
    try:
        answer = _receive(receiving, time.monotonic() + seconds)
    finally:
        os.close(receiving)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if answer is None or status == -signal.SIGXCPU:
        return pack(Failed(TimedOut(f"stopped after {seconds:g} s, which is the limit").info))
    return answer or pack(Failed(_too_large(memory).info))


def _work(work: Callable[[], Reply], seconds: float, memory: int, sending: int) -> None:
    """Do the work in the fork, which ends with this."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        cpu_seconds = math.ceil(seconds) + 1  # the kernel stops the fork if the program cannot do it in time
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            answer = pack(work())
        except RceError as error:
            answer = pack(Failed(error.info))
        except MemoryError:
            answer = pack(Failed(_too_large(memory).info))
        with os.fdopen(sending, "wb") as out:
            out.write(answer)
    finally:
        os._exit(0)


def _too_large(memory: int) -> RceError:
    return LimitExceeded(f"stopped: it needs more than {memory // 1024**2} MiB of memory", limit=memory)


def _receive(source: int, deadline: float) -> bytes | None:
    """Return all that comes until the end, empty if the fork died; None if it takes too long."""
    received = bytearray()
    while True:
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([source], [], [], left)[0]:
            return None
        piece = os.read(source, PIECE)
        if not piece:
            return bytes(received)
        received += piece


if __name__ == "__main__":
    with open(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # what libraries print must not get between the replies
        run(sys.stdin.buffer, out)
