"""Service calls that a gateway makes for itself, as those for parameters."""

from __future__ import annotations

import asyncio
import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any

from msgspec import Raw

from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import CALL, Arrived, Frame, Use
from rce.errors import RceError, TimedOut

MAX_SERVICES = 100  # services that are kept for further calls
TIMEOUT = 10.0  # seconds


class Asker:
    """Calls services of a guest's environment."""

    def __init__(self, guest: Guest) -> None:
        self._guest = guest
        self._numbers = itertools.count(1)
        self._uses: dict[str, Use] = {}
        self._busy = Counter[str]()  # unanswered calls by service
        self._turn = asyncio.Semaphore(MAX_SERVICES)
        self._answers: dict[str, asyncio.Future[bytes]] = {}

    async def __call__(self, service: str, type: str, args: bytes) -> bytes:
        """Call a service; return the response as JSON.

        Raises:
            TimedOut: There is no answer within 10 s.
            RceError: The call failed, or its service is no longer there for the guest.
        """
        async with self._turn:
            self._busy[service] += 1
            try:
                return await self._call(service, type, args)
            finally:
                self._busy[service] -= 1
                if not self._busy[service]:
                    del self._busy[service]

    async def _call(self, service: str, type: str, args: bytes) -> bytes:
        number = str(next(self._numbers))
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        try:
            async with asyncio.timeout(TIMEOUT):
                use = self._use_of(service, type)
                await asyncio.shield(use.ready)
                self._guest.data(use, number, Raw(args), lambda error: self._failed(number, error))
                either: tuple[asyncio.Future[Any], ...] = (answer, use.ended)
                await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
                if not answer.done():
                    use.ended.result()  # raises why it has ended
                return answer.result()
        except TimeoutError:
            raise TimedOut(f"service {service} did not answer within {TIMEOUT:g} s") from None
        finally:
            del self._answers[number]

    def _use_of(self, service: str, type: str) -> Use:
        present = self._uses.get(service)
        if present is not None and not present.ended.done():
            return present
        if present is None and len(self._uses) >= MAX_SERVICES:
            idle = next(name for name in self._uses if name not in self._busy)
            self._guest.drop(self._uses.pop(idle))
        use = self._uses[service] = self._guest.use(CALL, service, type, self._answered, self._failed)
        return use

    def _answered(self, arrived: Arrived) -> Sequence[Frame]:
        answer = self._answers.get(arrived.message.msgID)
        if answer is not None and not answer.done():
            answer.set_result(bytes(arrived.value[:-1]))
        return ()

    def _failed(self, number: str, error: RceError) -> None:
        answer = self._answers.get(number)
        if answer is not None and not answer.done():
            answer.set_exception(error)
