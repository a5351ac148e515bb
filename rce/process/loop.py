"""Event loop of a server process: uvloop, shared by asyncio and Twisted's reactor.

A process has one reactor, and importing `twisted.internet.reactor` installs the default one. So no module imports that
name; main functions pass the reactor to the code that needs it.
"""

from __future__ import annotations

import asyncio
import gc
import signal
from collections.abc import Callable, Coroutine

import uvloop
from twisted.internet.base import ReactorBase
from twisted.internet.error import CannotListenError
from twisted.internet.main import installReactor
from twisted.internet.protocol import Factory
from twisted.logger import Logger

from rce.errors import RceError, describe_os_error, port_unavailable
from rce.process import logs, metrics, open_files
from rce.process.reactor import UvloopReactor

log = Logger()
Main = Callable[[ReactorBase], Coroutine[None, None, None]]


def install(loop: asyncio.AbstractEventLoop) -> ReactorBase:
    """Install a reactor that runs on `loop`, and return it.

    Raises:
        ReactorAlreadyInstalledError: Something has imported `twisted.internet.reactor`.
    """
    reactor = UvloopReactor(loop)
    installReactor(reactor)
    return reactor


def run(main: Main, *, quiet: bool = False) -> int:
    """Run `main` to its end and return the exit status of the process.

    Logs go to standard error, if `quiet` only warnings and errors. The limit of open files is raised.

    The first SIGINT or SIGTERM cancels `main`, which cleans up in its `finally`; later signals are ignored, because
    Ctrl-C in a terminal is often followed by a SIGTERM from the parent process.

    Returns:
        0 if `main` returned or was stopped by a signal, 1 if it raised. RceErrors, ports in use and unusable files are
        logged as one line, other exceptions with their traceback.
    """
    logs.start(quiet=quiet)
    open_files.raise_limit()
    Factory.noisy = False
    gc.freeze()  # what is loaded stays: full collections are shorter, and less garbage comes together before the next
    loop = uvloop.new_event_loop()
    asyncio.set_event_loop(loop)
    reactor = install(loop)
    outcome: list[int] = []

    async def run_main() -> None:
        task = loop.create_task(main(reactor))
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, _stop, task, number)
        outcome.append(await _status(task))
        reactor.stop()

    tasks = [loop.create_task(run_main()), loop.create_task(metrics.watch_loop())]
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
        refused = port_unavailable(str(error.interface or ""), error.port, error.socketError)
        log.error("{error}", error=str(refused), code=refused.code)
        return 1
    except OSError as error:
        if error.filename is None:  # without a file name the message would not help a user
            log.failure("unhandled exception: the process ends")
        else:
            log.error("{error}", error=describe_os_error(error), code="unavailable")
        return 1
    except Exception:  # noqa: BLE001  # logged here, since the process ends with status 1
        log.failure("unhandled exception: the process ends")
        return 1
    return 0


async def _end_tasks() -> None:
    left = asyncio.all_tasks() - {asyncio.current_task()}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)
