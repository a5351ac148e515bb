"""Knowledge service in this process, for the client that programs of an environment use."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

from rce.api.knowledge_requests import KnowledgeAnswer, KnowledgeRequest
from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.control.calls.knowledge import AnswerKnowledge
from rce.errors import Unavailable
from tests.support.knowledge import Service


class DirectKnowledge(EnvironmentKnowledge):
    """Client that asks a service on another thread, without a platform between them."""

    def __init__(self, service: Service, loop: asyncio.AbstractEventLoop) -> None:
        self._service, self._loop = service, loop

    def ask(self, request: KnowledgeRequest) -> KnowledgeAnswer:
        answer = self._service.service.environments.answer(AnswerKnowledge("ann/brain", request))
        try:
            return asyncio.run_coroutine_threadsafe(answer, self._loop).result(60)
        except CancelledError:
            raise Unavailable("the knowledge service has stopped") from None


@contextmanager
def direct_knowledge(directory: Path) -> Iterator[EnvironmentKnowledge]:
    """Run a service on a thread, and yield a client of it."""
    loop = asyncio.new_event_loop()
    thread = Thread(target=loop.run_forever, daemon=True)
    thread.start()

    def run(work: object) -> None:
        asyncio.run_coroutine_threadsafe(work, loop).result(60)  # type: ignore[arg-type]

    async def cancel_requests() -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def make() -> Service:
        return Service(directory)

    service = asyncio.run_coroutine_threadsafe(make(), loop).result(60)
    run(service.start())
    try:
        yield DirectKnowledge(service, loop)
    finally:
        run(service.stop())
        run(cancel_requests())
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
