"""The program of an Environment endpoint: `python -P -m endpoints.environment`."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Coroutine
from pathlib import Path

from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from endpoints.data_port import DataPort
from endpoints.environment import surroundings
from endpoints.environment.nodelog import NodeLog
from endpoints.environment.settings import Settings
from endpoints.host import listen
from rce import __version__, logs, loop
from rce.calls.call import Call, Nothing
from rce.calls.joining import Hello, Welcome
from rce.control import MasterLink
from rce.errors import RceError
from rce.host import host_identity
from rce.settings import load_or_exit
from rce.tls import load

SWITCH_INTERVAL = 0.0005  # seconds after which the loop lets the ROS thread in, and the other way round
PAUSE = 0.02  # seconds between looks for a file, for which there is no event

log = Logger()


class Endpoint:
    """Joins the Master's connection and the environment."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._token = settings.token
        self._addresses: list[str] = []
        self._master: MasterLink
        self._telling: set[asyncio.Task[None]] = set()

    async def run(self, reactor: ReactorBase) -> None:
        """Until it is cancelled, or the Master refuses us."""
        # Not before `surroundings.prepare`: they load ROS 2.
        from endpoints.environment.endpoint import Environment
        from endpoints.environment.ros import RosThread

        tls = load(self._settings.tls)
        port = DataPort(self._settings.relay, tls)
        socket = self._settings.socket or self._settings.data_dir.absolute() / "data.sock"
        self._addresses = await listen(port, socket, self._settings.listen)
        ros = RosThread(asyncio.get_running_loop())
        await ros.start()
        output = NodeLog(self._settings.data_dir / "environment.log")
        logs.also(lambda line: output.write(line.encode()))
        environment = Environment(self._settings, ros, port, self.tell, output)
        self._master = MasterLink(
            reactor, self._settings.master, self._hello, environment.handlers(), self._welcomed, tls
        )
        master = asyncio.create_task(self._master.run())
        running = asyncio.create_task(environment.run())
        try:
            await asyncio.wait([master, running], return_when=asyncio.FIRST_COMPLETED)
        finally:
            master.cancel()
            running.cancel()
            await asyncio.wait([running, master])
            await port.close()
        for task in (running, master):
            if not task.cancelled():
                task.result()

    def tell(self, call: Call[Nothing]) -> None:
        """Send a call to the Master; when that is away, once it is back, if that is soon."""
        task = asyncio.create_task(self._tell(call))
        self._telling.add(task)
        task.add_done_callback(self._telling.discard)

    async def _tell(self, call: Call[Nothing]) -> None:
        try:
            await self._master.call(call)
        except RceError as error:
            log.warn("{call} was not heard: {error}", call=type(call).__name__, error=str(error))

    def _hello(self) -> Hello:
        return Hello(
            "environment",
            self._settings.name,
            self._token,
            __version__,
            host=self._settings.host or host_identity(),
            addresses=[*self._addresses, *self._relay_address()],
        )

    def _relay_address(self) -> list[str]:
        """Of its machine's relay, where that is not its task set's and so says it beside the gate."""
        file = self._settings.relay.with_suffix(".address") if self._settings.relay else None
        return [f"{file.read_text()}/{self._settings.name}"] if file and file.exists() else []

    def _welcomed(self, welcome: Welcome) -> None:
        self._token = welcome.credential


def _wait_for_way(master: str) -> None:
    """In a swarm the agent of a node opens the way to the Master when all that this environment needs is there."""
    while master.startswith("unix:") and not Path(master.removeprefix("unix:")).exists():
        time.sleep(PAUSE)


def main() -> int:
    settings = load_or_exit(Settings, "rce environment")
    os.environ.pop("RCE_TOKEN", None)  # nodes shall not inherit it
    _wait_for_way(settings.master)
    surroundings.prepare(settings)
    sys.setswitchinterval(SWITCH_INTERVAL)

    def run(reactor: ReactorBase) -> Coroutine[None, None, None]:
        return Endpoint(settings).run(reactor)

    return loop.run(run)


if __name__ == "__main__":
    sys.exit(main())
