"""`python -P -m master`: the Master."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
from ipaddress import IPv4Network
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct
from twisted.internet import endpoints
from twisted.internet.address import IPv4Address, IPv6Address
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort
from twisted.logger import Logger
from twisted.web.server import Site

from master.api.resources import make_api
from master.api.site import ApiSite
from master.depot import Depot
from master.entry import Entry
from master.groups import PREFIX
from master.machines import Inviter, Registrar, Registry, SmallRequest, port_of
from master.policies import IMAGES, Policy, parse, with_changes
from master.processes import Processes
from master.records import GROUP_POOL, Role
from master.service import Master
from master.store import Store
from master.users import Users
from rce import control, loop, settings
from rce.certificates import Authority
from rce.errors import InvalidRequest
from rce.ready import Ready, announce
from rce.sole import sole_user
from rce.tls import CA, CERTIFICATE, KEY, PLAIN, exposed, interface, load

log = Logger("master")
DEFAULT_LIMITS = ["package_bytes=2Gi", "connections=20000"]


class Settings(Struct):
    """The Master: users, command graph, placement, the robots' HTTP entry."""

    data_dir: Annotated[Path, Meta(description="directory for the database")]
    http: Annotated[str, Meta(description="Twisted server endpoint of the entry; ssl:… for https")] = "tcp:9000"
    control: Annotated[str, Meta(description="Twisted server endpoint for the platform's processes")] = (
        "tcp:8080:interface=127.0.0.1"
    )
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem, for TLS between machines")
    ] = None
    database: Annotated[str, Meta(description="SQLAlchemy URL; a SQLite file in the data directory if empty")] = ""
    group_pool: Annotated[str, Meta(description="network of which each network group gets a /24")] = str(GROUP_POOL)
    grace: Annotated[float, Meta(ge=0, description="seconds for which a robot without a socket keeps its session")] = 10
    machine_grace: Annotated[
        float, Meta(gt=0, description="seconds for which a machine may be away until its environments move to others")
    ] = 30
    audit_days: Annotated[
        float, Meta(ge=0, description="days for which the audit log is kept; 0: for as long as there is room")
    ] = 400
    dev: Annotated[bool, Meta(description="create the users admin/admin and testUser/testUser")] = False
    limits: Annotated[
        list[str], Meta(description="limits of users who have none of their own, key=value as in `rce user limits`")
    ] = []
    images: Annotated[list[str], Meta(description="images that all users may run, beside the platform's own")] = []
    machines: Annotated[str, Meta(description="Twisted server endpoint where machines join (tcp:8081); needs tls")] = ""
    authority_key: Annotated[str, Meta(description="PEM file: the key of ca.pem, which signs their certificates")] = ""
    address: Annotated[str, Meta(description="HOST by which other machines reach this Master, for join codes")] = ""
    source: Annotated[str, Meta(description="archive of RCE that machines may fetch where they join")] = ""
    tokens: Annotated[list[str], Meta(description="one-time join tokens role:process:token of processes to come")] = []


async def serve(reactor: ReactorBase, options: Settings) -> None:
    """Run until cancelled."""
    with sole_user(options.data_dir, "Master"):  # two would write over each other in one database
        await _serve(reactor, options)


async def _serve(reactor: ReactorBase, options: Settings) -> None:
    http = loopback_only(options.http) if options.dev else options.http
    endpoint = control.server_endpoint(reactor, http)
    tls = load(options.tls)
    if exposed(interface(options.control), tls):
        log.warn(PLAIN, what="control", host=interface(options.control) or "all addresses")
    store = Store(options.database or f"sqlite:///{options.data_dir / 'master.db'}")
    await store.open()
    depot = Depot(options.data_dir / "packages")
    master = Master(store, options.grace, platform_policy(options), options.machine_grace, depot)
    master.state.group_pool = _pool(options.group_pool)
    await first_users(master.users, options.dev)
    for entry in options.tokens:
        role, process, token = _token(entry)
        await master.processes.allow(process, role, token)
    await master.start()
    tidying = asyncio.create_task(master.audit.tidy(options.audit_days))
    ports = [await control.listen(reactor, options.control, master, tls)]
    try:
        inviter = Inviter.of(master.processes, options.machines, options.tls, options.address)
        api = make_api(master, depot, inviter)
        site = ApiSite(Entry(master.state), api, depot)
        ports.append(await endpoint.listen(site).asFuture(asyncio.get_running_loop()))
        if options.machines:
            ports.append(await _registry(reactor, options, master.processes))
        scheme = "https" if http.startswith("ssl") else "http"
        master.entry = (scheme, _address(ports[1]).port)
        inside, outside = (f"{address.host}:{address.port}" for address in map(_address, ports[:2]))
        log.info("Master serves robots at {http}, its processes at {control}", http=outside, control=inside)
        announce(Ready("master", f"{scheme}://{outside}/", f"tcp:{inside}"))
        await asyncio.Event().wait()
    finally:
        for port in ports:
            port.stopListening()  # type: ignore[misc]  # zope declares its methods without self
        tidying.cancel()
        await master.stop()
        await store.close()


def platform_policy(options: Settings) -> Policy:
    """What users may have who have no limits of their own. InvalidRequest."""
    return with_changes(Policy(images=[*IMAGES, *options.images]), parse([*DEFAULT_LIMITS, *options.limits]))


async def _registry(reactor: ReactorBase, options: Settings, processes: Processes) -> IListeningPort:
    """Where new machines join."""
    if not (options.tls and options.authority_key and options.address):
        raise InvalidRequest("machines can join with the settings tls, authority_key and address only")
    authority = Authority.load(options.tls / CA, Path(options.authority_key))
    registrar = Registrar(processes, authority, f"{options.address}:{port_of(options.control)}")
    try:
        registry = Registry(registrar, Path(options.source) if options.source else None)
    except OSError as error:
        raise InvalidRequest(f"setting source: {error}", field="source") from None
    key, certificate = (endpoints.quoteStringArgument(str(options.tls / name)) for name in (KEY, CERTIFICATE))
    description = f"ssl:{options.machines.partition(':')[2]}:privateKey={key}:certKey={certificate}"
    endpoint = control.server_endpoint(reactor, description)
    port: IListeningPort = await endpoint.listen(Site(registry, requestFactory=SmallRequest)).asFuture(
        asyncio.get_running_loop()
    )
    return port


def _address(port: IListeningPort) -> IPv4Address | IPv6Address:
    address: IPv4Address | IPv6Address = port.getHost()  # type: ignore[misc]  # zope, as above
    return address


async def first_users(users: Users, dev: bool) -> None:
    """At the very first start: the development users, or an administrator with a password that is shown once."""
    if await users.names():
        return
    if dev:
        await users.add("admin", "admin", "admin")
        await users.add("testUser", "testUser")
        log.warn("development mode: users admin/admin and testUser/testUser exist; do not let others reach this Master")
        return
    password = secrets.token_urlsafe(15)
    await users.add("admin", password, "admin")
    print(f"The administrator is 'admin' with password '{password}'. It is not shown again.", flush=True)


def loopback_only(description: str) -> str:
    """The server endpoint at the loopback address: the development users are for this machine."""
    if "interface=" not in description:
        return description + ":interface=127.0.0.1"
    if description.partition("interface=")[2].partition(":")[0] not in ("127.0.0.1", "localhost"):
        raise InvalidRequest(f"--dev serves this machine only, and --http={description} does not: leave one out")
    return description


def _pool(text: str) -> IPv4Network:
    try:
        pool = IPv4Network(text)
    except ValueError as error:
        raise InvalidRequest(f"setting group_pool: {error}", field="group_pool") from None
    if pool.prefixlen > PREFIX:
        raise InvalidRequest(f"setting group_pool: {text} is smaller than a /{PREFIX}", field="group_pool")
    return pool


def _token(entry: str) -> tuple[Role, str, str]:
    match entry.split(":"):
        case ["robot" | "container" | "service" as role, process, token] if process and token:
            return role, process, token
    raise InvalidRequest("setting tokens: write each as role:process:token, role being robot, container or service")


def main() -> int:
    options = settings.load_or_exit(Settings, "rce master")
    os.environ.pop("RCE_TOKENS", None)
    return loop.run(lambda reactor: serve(reactor, options))


if __name__ == "__main__":
    sys.exit(main())
