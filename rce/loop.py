"""The event loop of a server process: uvloop, which asyncio and Twisted's reactor share.

Twisted keeps one reactor a process and takes whichever is there when `twisted.internet.reactor` is first imported.
So nothing imports that name: what needs the reactor is handed it by its main function.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Coroutine

import uvloop
from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.internet.main import installReactor
from twisted.internet.protocol import Factory
from twisted.logger import Logger

from rce import logs, metrics
from rce.errors import RceError, no_port, reason
from rce.reactor import UvloopReactor

log = Logger()
Main = Callable[[ReactorBase], Coroutine[None, None, None]]


def install(loop: asyncio.AbstractEventLoop) -> ReactorBase:
    """Make Twisted's reactor run on `loop`; ReactorAlreadyInstalledError if something imported a reactor before."""
    reactor = UvloopReactor(loop)
    installReactor(reactor)
    return reactor


def run(main: Main) -> int:
    """Run `main` to its end and return the exit status of the process; logs go to standard error.

    The first SIGINT or SIGTERM cancels `main`, which cleans up in its `finally`; later ones change nothing, because a
    terminal's Ctrl-C and the parent's SIGTERM often arrive both. 0 when `main` returned or was stopped by a signal, 1
    when it raised: an RceError, a port that is taken and a file that cannot be used are logged as a
    sentence, anything else with its traceback.
    """
    logs.begin()
    Factory.noisy = False
    loop = uvloop.new_event_loop()
    asyncio.set_event_loop(loop)
    reactor = install(loop)
    outcome: list[int] = []

    async def whole() -> None:
        task = loop.create_task(main(reactor))
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, _stop, task, number)
        outcome.append(await _status(task))
        reactor.stop()

    tasks = [loop.create_task(whole()), loop.create_task(metrics.watch_loop())]
    reactor.run(installSignalHandlers=False)
    loop.run_until_complete(tasks[0])
    loop.run_until_complete(_end_tasks())
    loop.run_until_complete(loop.shutdown_asyncgens())
    loop.close()
    return outcome[0]


def _stop(task: asyncio.Task[None], number: int) -> None:
    if not task.cancelling():
        log.info("stopping on {signal}", signal=signal.Signals(number).name)
        task.cancel()


async def _status(task: asyncio.Task[None]) -> int:
    try:
        await task
    except asyncio.CancelledError:
        return 0
    except RceError as error:
        log.error("{error}", error=str(error), code=error.info.code)
        return 1
    except CannotListenError as error:
        refused = no_port(str(error.interface or ""), error.port, error.socketError)
        log.error("{error}", error=str(refused), code=refused.code)
        return 1
    except OSError as error:
        if error.filename is None:  # nothing that a reader could look at
            log.failure("the process ends by a defect")
        else:
            log.error("{error}", error=reason(error), code="unavailable")
        return 1
    except Exception:  # noqa: BLE001  # the last one who can tell: the process ends with status 1
        log.failure("the process ends by a defect")
        return 1
    return 0


async def _end_tasks() -> None:
    left = asyncio.all_tasks() - {asyncio.current_task()}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)
