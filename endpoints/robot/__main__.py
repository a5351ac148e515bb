"""Entry point of a Robot endpoint: `python -P -m endpoints.robot`."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase
from twisted.logger import Logger

import rce
from endpoints.data.port import DataPort
from endpoints.gateways.paths import gateways
from endpoints.robot.endpoint import Options, RobotEndpoint
from endpoints.robot.frame_receiver import ServerLimits
from endpoints.robot.server import listen
from endpoints.robot.siblings import Siblings, sibling_arguments
from rce.control.calls.joining import Hello, SetRemovedMachines, Welcome
from rce.control.client import ControlClient
from rce.control.credential import Credential, stay_joined
from rce.net.tls import load_tls, public_tls_context
from rce.process import loop, settings
from rce.process.host import host_identity
from rce.process.malloc import keep_large_blocks
from rce.process.ready import Ready, announce

MEGABYTE = 1024 * 1024

log = Logger("robot")


class Settings(Struct):
    """A Robot endpoint: WebSockets of robots on one side, data links on the other."""

    data_dir: Annotated[Path, Meta(description="directory for the credential and the data socket")]
    name: Annotated[str, Meta(description="name of this Robot endpoint, unique in the platform")] = "robot-1"
    master: Annotated[
        str, Meta(description="Twisted client endpoint of the Master's control port; of several: comma-separated")
    ] = "tcp:127.0.0.1:8080"
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN")] = ""
    ws_host: Annotated[str, Meta(description="address on which to serve robots")] = "127.0.0.1"
    ws_port: Annotated[int, Meta(ge=0, le=65535, description="port for robots; 0: any free one")] = 9010
    processes: Annotated[
        int, Meta(ge=1, le=64, description="processes that serve robots at this port, a core each")
    ] = 1
    share_port: Annotated[bool, Meta(description="let other Robot endpoints of this machine use ws_port, too")] = False
    public_url: Annotated[str, Meta(description="URL given to robots, wss://host:port/; empty: from their request")] = (
        ""
    )
    certificate: Annotated[str, Meta(description="PEM file for wss")] = ""
    private_key: Annotated[str, Meta(description="PEM file of the certificate's key")] = ""
    data_host: Annotated[str, Meta(description="address for data links from other machines; empty: none")] = ""
    data_port: Annotated[int, Meta(ge=0, le=65535, description="port for data links; 0: any free one")] = 0
    data_address: Annotated[str, Meta(description="name or address by which others dial it; empty: data_host")] = ""
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem, for TLS between machines")
    ] = None
    host: Annotated[str, Meta(description="identity of this machine; empty: detected")] = ""
    grace: Annotated[float, Meta(ge=0, description="seconds for which a robot without a socket keeps its session")] = 10
    service_timeout: Annotated[float, Meta(gt=0, description="seconds until a service call fails")] = 30
    message_size: Annotated[int, Meta(ge=1, le=1024, description="largest message in MB")] = 64
    bad_messages: Annotated[int, Meta(ge=0, description="bad messages a minute that close a socket; 0: no limit")] = 100
    unfinished_blobs: Annotated[int, Meta(ge=1, description="unfinished blobs that a robot may have")] = 64
    unfinished_size: Annotated[int, Meta(ge=1, description="total size of unfinished blobs in MB")] = 256
    queue_size: Annotated[
        int, Meta(ge=320, description="size of all messages that wait, in MB; a user has a half, a robot a quarter")
    ] = 512
    converters: Annotated[
        str, Meta(description="Python file, or directory of files, with converters of your own; see the guide")
    ] = ""
    original_forwarders: Annotated[
        Literal["cdr", "ros1"],
        Meta(description="what Forwarders of robots without features carry: CDR, or messages as ROS 1 serializes them"),
    ] = "cdr"


def robot_url(options: Settings, port: int, host: str = "") -> str:
    """Return the URL at which robots find this endpoint.

    Args:
        options: Settings, whose `public_url` takes precedence.
        port: Port at which the endpoint listens.
        host: Name or address; empty for a URL in which the Master fills in the host of the robot's request.
    """
    scheme = "wss" if options.certificate else "ws"
    return options.public_url or f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}/"


def _options(options: Settings, limits: ServerLimits) -> Options:
    queues = options.queue_size * MEGABYTE
    converters, forwarders = options.converters, options.original_forwarders
    return Options(limits, options.grace, options.service_timeout, queues, converters, forwarders)


def _siblings(options: Settings, port: int) -> Siblings:
    def arguments(number: int) -> list[str]:
        return sibling_arguments(sys.argv[1:], options.name, options.data_dir, port, options.data_port, number)

    return Siblings(options.processes, options.data_dir, arguments, sys.stderr)


async def serve(reactor: ReactorBase, options: Settings) -> None:
    """Run until cancelled, or until the Master refuses this endpoint."""
    options.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    credential = Credential(options.data_dir / "credential", options.token)
    tls = load_tls(options.tls)
    port = DataPort(tls=tls)
    socket = options.data_dir.absolute() / "data.sock"
    addresses = await port.listen(socket, options.data_host, options.data_port, options.data_address)
    limits = ServerLimits(
        options.message_size * MEGABYTE,
        options.bad_messages,
        options.unfinished_blobs,
        options.unfinished_size * MEGABYTE,
    )
    endpoint = RobotEndpoint(port, _options(options, limits))
    await endpoint.load_converters()
    tls_context = public_tls_context(options.certificate, options.private_key)
    shared = options.share_port or options.processes > 1
    server = await listen(endpoint, options.ws_host, options.ws_port, tls_context, gateways(endpoint), shared)
    ws_port = server.port
    url = robot_url(options, ws_port)
    incarnation = secrets.token_hex(16)

    def hello() -> Hello:
        return Hello(
            "robot",
            options.name,
            credential.secret,
            rce.__version__,
            incarnation,
            options.host or host_identity(),
            addresses,
            url,
            robots=list(endpoint.sessions),
            away=endpoint.report_away(),
            credential=credential.own,
        )

    def welcomed(welcome: Welcome) -> None:
        credential.keep(welcome)
        announce(Ready("robot", url))

    def refuse_removed(call: SetRemovedMachines) -> None:
        if tls is not None:
            tls.set_removed(call.machines)

    handlers = endpoint.handlers()
    handlers.do(SetRemovedMachines, refuse_removed)
    endpoint.master = ControlClient(reactor, options.master, hello, handlers, welcomed, tls)
    log.info(
        "Robot endpoint {name} serves robots at {url}",
        name=options.name,
        url=robot_url(options, ws_port, options.ws_host),
    )
    siblings = asyncio.create_task(_siblings(options, ws_port).run(endpoint.master.call))
    try:
        await stay_joined(endpoint.master, credential)
    finally:
        siblings.cancel()
        await asyncio.wait([siblings])
        server.close()
        endpoint.workers.close()
        await port.close()


def main() -> int:
    """Run the program; return its exit status."""
    options = settings.load_or_exit(Settings, "rce robot")
    os.environ.pop("RCE_TOKEN", None)
    keep_large_blocks()
    return loop.run(lambda reactor: serve(reactor, options))


if __name__ == "__main__":
    sys.exit(main())
