"""Entry point of an Environment endpoint: `python -P -m endpoints.environment`."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import TYPE_CHECKING

from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from endpoints.data.port import DataPort
from endpoints.environment import process_environment
from endpoints.environment.knowledge_socket import KnowledgeSocket
from endpoints.environment.output_log import OutputLog
from endpoints.environment.prepared_node import Spare
from endpoints.environment.settings import Settings
from rce import __version__
from rce.control.calls.call import Call, Nothing
from rce.control.calls.joining import Hello, Welcome
from rce.control.calls.knowledge import AskKnowledge
from rce.control.client import ControlClient
from rce.errors import RceError
from rce.net.tls import load_tls
from rce.process import logs, loop
from rce.process.host import host_identity
from rce.process.settings import load_or_exit

if TYPE_CHECKING:
    from endpoints.environment.ros import Ros

POLL_INTERVAL = 0.02  # seconds

log = Logger()


class Endpoint:
    """The program: an environment and its connection to the Master."""

    def __init__(self, settings: Settings, spare: Spare | None = None, ros: Ros | None = None) -> None:
        """Prepare for an environment.

        Args:
            settings: Its settings.
            spare: Interpreter for its first node, if one waits.
            ros: The ROS node, if it has joined the ROS domain already.
        """
        self._settings = settings
        self._spare = spare or Spare()
        self._ros = ros
        self._token = settings.token
        self._credential = secrets.token_hex(32)
        self._master: ControlClient
        self._reports: set[asyncio.Task[None]] = set()

    async def run(self, reactor: ReactorBase) -> None:
        """Run until cancelled, or until the Master refuses this endpoint."""
        # These load ROS 2, which needs the variables that `process_environment.prepare` has set.
        from endpoints.environment.endpoint import Environment
        from endpoints.environment.ros import Ros

        tls = load_tls(self._settings.tls)
        port = DataPort(self._settings.relay, tls)
        socket = self._settings.socket or self._settings.data_dir.absolute() / "data.sock"
        await port.listen(socket, offer=self._settings.listener)
        ros = self._ros or Ros()
        of_user = OutputLog(self._settings.data_dir / "environment.log")
        whole = OutputLog(self._settings.data_dir / "internal.log")
        logs.add_text_observer(lambda line: of_user.write(line.encode()), "endpoints.environment.")
        logs.add_text_observer(lambda line: whole.write(line.encode()))
        environment = Environment(self._settings, ros, port, self.report, of_user, whole, self._spare)
        self._master = ControlClient(
            reactor, self._settings.master, self._hello, environment.handlers(), self._welcomed, tls
        )
        knowledge = KnowledgeSocket(lambda request: self._master.call(AskKnowledge(request)))
        await knowledge.listen(self._settings.data_dir.absolute() / process_environment.KNOWLEDGE)
        master = asyncio.create_task(self._master.run())
        running = asyncio.create_task(environment.run())
        try:
            await asyncio.wait([master, running], return_when=asyncio.FIRST_COMPLETED)
        finally:
            master.cancel()
            running.cancel()
            await asyncio.wait([running, master])
            await knowledge.close()
            await port.close()
        for task in (running, master):
            if not task.cancelled():
                task.result()

    def report(self, call: Call[Nothing]) -> None:
        """Send a call to the Master; if it cannot be reached, the call waits a while for its return."""
        task = asyncio.create_task(self._report(call))
        self._reports.add(task)
        task.add_done_callback(self._reports.discard)

    async def _report(self, call: Call[Nothing]) -> None:
        try:
            await self._master.call(call)
        except RceError as error:
            log.warn("{call} could not be reported to the Master: {error}", call=type(call).__name__, error=str(error))

    def _hello(self) -> Hello:
        host = self._settings.host or host_identity()
        name, own = self._settings.name, self._credential
        return Hello("environment", name, self._token, __version__, host=host, credential=own)

    def _welcomed(self, welcome: Welcome) -> None:
        self._token = welcome.credential


def _wait_for_control_socket(master: str) -> None:
    """Wait until the control socket exists: in a swarm the node's agent creates it when all resources are ready."""
    while master.startswith("unix:") and not Path(master.removeprefix("unix:")).exists():
        time.sleep(POLL_INTERVAL)


def main() -> int:
    """Run the program; return its exit status."""
    settings = load_or_exit(Settings, "rce environment")
    os.environ.pop("RCE_TOKEN", None)  # so that nodes do not inherit it
    _wait_for_control_socket(settings.master)
    process_environment.prepare(settings)

    def run(reactor: ReactorBase) -> Coroutine[None, None, None]:
        return Endpoint(settings).run(reactor)

    return loop.run(run)


if __name__ == "__main__":
    sys.exit(main())
