"""`python -P -m master`: the Master."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
import sys
from ipaddress import IPv4Network
from pathlib import Path
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct
from twisted.internet.address import IPv4Address, IPv6Address
from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from master.access.enrolment import EnrolmentServer, Inviter, Registrar, port_of
from master.access.join_tokens import JoinTokens
from master.access.sealing import KEY_FILE, Seal
from master.access.users import Users, digest
from master.api.resources import make_api
from master.api.site import Site
from master.front import Front
from master.graph.groups import PREFIX
from master.graph.limits import IMAGES, Policy, parse, with_changes
from master.graph.records import Role
from master.graph.state import GROUP_POOL
from master.service import Master
from master.storage.archives import Archives
from master.storage.depot import Depot
from master.storage.leader_row import LeaderRow, create, fence
from master.storage.lease import Lease
from master.storage.store import Store
from rce.control.server import listen
from rce.errors import InvalidRequest, Unauthorized
from rce.net.certificates import Authority
from rce.net.tls import (
    CA,
    CERTIFICATE,
    KEY,
    PLAINTEXT_WARNING,
    Tls,
    is_exposed,
    listening_address,
    load_tls,
    public_tls_context,
)
from rce.process import loop, settings
from rce.process.garbage import collect_seldom
from rce.process.lock import lock_directory
from rce.process.malloc import return_freed_memory
from rce.process.ready import Ready, announce
from rce.web.server import Endpoint, parse_endpoint, serve_handler
from rce.web.server import listen as web_listen

log = Logger("master")
ADMIN, TEST_USER = DEVELOPMENT_USERS = "admin", "testUser"  # their passwords are their names
DEFAULT_LIMITS = ["package_bytes=2Gi", "recording_bytes=20Gi", "connections=20000"]


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
        list[str],
        Meta(description="limits of users without own ones: key=value as in `rce user limits`; key=- is none"),
    ] = []
    images: Annotated[list[str], Meta(description="images that all users may run, beside the platform's own")] = []
    machines: Annotated[str, Meta(description="Twisted server endpoint where machines join (tcp:8081); needs tls")] = ""
    authority_key: Annotated[str, Meta(description="PEM file: the key of ca.pem, which signs their certificates")] = ""
    address: Annotated[str, Meta(description="HOST by which other machines reach this Master, for join codes")] = ""
    masters: Annotated[
        list[str], Meta(description="HOSTs of all Masters with this database, for machines that join; empty: address")
    ] = []
    source: Annotated[str, Meta(description="archive of RCE that machines may fetch where they join")] = ""
    tokens: Annotated[list[str], Meta(description="one-time join tokens role:process:token of processes to come")] = []


async def _collect_and_serve(reactor: ReactorBase, options: Settings) -> None:
    return_freed_memory()
    collect_seldom(asyncio.get_running_loop().call_later)
    await serve(reactor, options)


async def serve(reactor: ReactorBase, options: Settings) -> None:
    """Run until cancelled."""
    with lock_directory(options.data_dir, "Master"):  # two would overwrite each other's rows in one database
        await _serve(reactor, options)


class Ports(NamedTuple):
    """Addresses of a Master: its HTTP entry, and the control port."""

    scheme: str
    host: str
    port: int
    control: IPv4Address | IPv6Address


async def _serve(reactor: ReactorBase, options: Settings) -> None:
    endpoint = parse_endpoint(loopback_only(options.http) if options.dev else options.http)
    tls = load_tls(options.tls)
    if is_exposed(listening_address(options.control), tls):
        log.warn(PLAINTEXT_WARNING, what="control", host=listening_address(options.control) or "all addresses")
    store = Store(options.database or f"sqlite:///{options.data_dir / 'master.db'}")
    async with contextlib.AsyncExitStack() as stack, contextlib.AsyncExitStack() as doors:  # the doors close first
        lease = await _prepare_lease(stack, store, options.data_dir) if store.shared else None
        stack.push_async_callback(store.close)
        front = Front(lease)
        doors.callback(front.close)
        if lease is not None:  # a standby answers, too
            ports = await _open_ports(doors, reactor, options, endpoint, tls, front, lease)
            await lease.take(_own_url(options, ports))
            store.fence = fence(lease)
        await store.open()
        master, site = await _start_master(stack, options, store, tls)
        front.lead(master, site)
        if lease is None:
            ports = await _open_ports(doors, reactor, options, endpoint, tls, front, None)
        doors.push_async_callback(site.stop)
        if options.machines:
            enrolment = _enrolment_server(options, master.join_tokens)
            doors.push_async_callback(enrolment.stop)
            await enrolment.start(_enrolment_endpoint(options))
        await create_first_users(master.users, options.dev)  # last: a start that fails must not use up the password
        master.entry = (ports.scheme, ports.port)
        _announce(ports)
        if lease is None:
            await asyncio.Event().wait()
        else:
            _end_at_once(await asyncio.shield(lease.lost))


async def _prepare_lease(stack: contextlib.AsyncExitStack, store: Store, data_dir: Path) -> Lease:
    await store.prepare(create)
    row = LeaderRow(store.url, _identity(data_dir))
    stack.callback(row.close)
    lease = Lease(row)
    stack.push_async_callback(lease.release)
    return lease


def _identity(data_dir: Path) -> str:
    """Return the identity of a data directory, which it keeps."""
    file = data_dir / "identity"
    if not file.exists():
        temporary = file.with_suffix(".new")
        temporary.write_text(secrets.token_hex(16))
        temporary.replace(file)
    return file.read_text().strip()


async def _open_ports(
    doors: contextlib.AsyncExitStack,
    reactor: ReactorBase,
    options: Settings,
    endpoint: Endpoint,
    tls: Tls | None,
    front: Front,
    lease: Lease | None,
) -> Ports:
    control = await listen(reactor, options.control, front, tls, lease)
    doors.callback(control.stopListening)  # type: ignore[misc]  # zope declares its methods without self
    runner = serve_handler(front.handle)
    doors.push_async_callback(runner.cleanup)
    host, port = await web_listen(runner, endpoint)
    return Ports(endpoint.scheme, host, port, control.getHost())  # type: ignore[misc]  # as above


async def _start_master(
    stack: contextlib.AsyncExitStack, options: Settings, store: Store, tls: Tls | None
) -> tuple[Master, Site]:
    depot = Depot(options.data_dir / "packages", Archives(store) if store.shared else None)
    seal = Seal(options.data_dir / KEY_FILE)
    master = Master(store, options.grace, platform_policy(options), options.machine_grace, depot, tls, seal)
    master.state.group_pool = _pool(options.group_pool)
    for entry in options.tokens:
        role, process, token = _parse_token(entry)
        await master.join_tokens.allow(process, role, token)
    await master.start()
    stack.push_async_callback(master.stop)
    tidying = asyncio.create_task(master.audit.tidy(options.audit_days))
    stack.callback(tidying.cancel)
    inviter = Inviter.from_settings(master.join_tokens, options.machines, options.tls, options.address)
    return master, Site(master.state, make_api(master, depot, inviter), depot)


def _own_url(options: Settings, ports: Ports) -> str:
    """Return the URL of this Master's entry for clients of a standby."""
    host = options.address or (socket.getfqdn() if ports.host in ("0.0.0.0", "::") else ports.host)
    return f"{ports.scheme}://{f'[{host}]' if ':' in host else host}:{ports.port}/"


def _announce(ports: Ports) -> None:
    inside = f"{ports.control.host}:{ports.control.port}"
    outside = f"[{ports.host}]:{ports.port}" if ":" in ports.host else f"{ports.host}:{ports.port}"
    log.info("Master serves robots at {http}, its processes at {control}", http=outside, control=inside)
    announce(Ready("master", f"{ports.scheme}://{outside}/", f"tcp:{inside}"))


def _end_at_once(reason: str) -> None:
    """End this process without another word to anybody: what it has in memory may be out of date."""
    log.critical("this Master does not lead any more: {reason}. It ends, to be started as a standby", reason=reason)
    sys.stderr.flush()
    os._exit(1)


def platform_policy(options: Settings) -> Policy:
    """Return the limits of users who have none of their own.

    Raises:
        InvalidRequest: A setting is malformed.
    """
    return with_changes(Policy(images=[*IMAGES, *options.images]), parse([*DEFAULT_LIMITS, *options.limits]))


def _enrolment_server(options: Settings, join_tokens: JoinTokens) -> EnrolmentServer:
    if not (options.tls and options.authority_key and options.address):
        raise InvalidRequest("machines can join with the settings tls, authority_key and address only")
    authority = Authority.load(options.tls / CA, Path(options.authority_key))
    port = port_of(options.control)
    addresses = ",".join(f"{host}:{port}" for host in options.masters or [options.address])
    registrar = Registrar(join_tokens, authority, addresses)
    try:
        return EnrolmentServer(registrar, Path(options.source) if options.source else None)
    except OSError as error:
        raise InvalidRequest(f"setting source: {error}", field="source") from None


def _enrolment_endpoint(options: Settings) -> Endpoint:
    """Return where machines join, always with the platform's own certificate."""
    assert options.tls is not None
    certificate = public_tls_context(str(options.tls / CERTIFICATE), str(options.tls / KEY))
    return parse_endpoint(options.machines)._replace(tls=certificate)


async def create_first_users(users: Users, dev: bool) -> None:
    """Create the development users, or an administrator whose password is printed once, unless there are users."""
    if await users.names():
        if not dev:
            await _warn_of_development_users(users)
        return
    if dev:
        await users.add(ADMIN, ADMIN, "admin")
        await users.add(TEST_USER, TEST_USER)
        log.warn("development mode: users admin/admin and testUser/testUser exist; do not let others reach this Master")
        return
    password = secrets.token_urlsafe(15)
    await users.add(ADMIN, password, "admin")
    print(f"The administrator is 'admin' with password '{password}'. Keep it: it is not shown again.", flush=True)


async def _warn_of_development_users(users: Users) -> None:
    """Warn if users of an earlier start with --dev still have their well-known passwords."""
    for name in DEVELOPMENT_USERS:
        with contextlib.suppress(Unauthorized):
            await users.check_password(name, digest(name), "")
            log.warn(
                "user {name} has its password of development mode, from an earlier start with --dev: change it "
                "(`rce user passwd {name}`), remove the user, or use another data directory",
                name=name,
            )


def loopback_only(description: str) -> str:
    """Return the server endpoint, bound to the loopback address: the development users have known passwords.

    Raises:
        InvalidRequest: It names another address.
    """
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


def _parse_token(entry: str) -> tuple[Role, str, str]:
    match entry.split(":"):
        case ["robot" | "container" | "service" as role, process, token] if process and token:
            return role, process, token
    raise InvalidRequest("setting tokens: write each as role:process:token, role being robot, container or service")


def main() -> int:
    """Run the Master until it is stopped, and return the exit status."""
    options = settings.load_or_exit(Settings, "rce master")
    os.environ.pop("RCE_TOKENS", None)
    return loop.run(lambda reactor: _collect_and_serve(reactor, options))


if __name__ == "__main__":
    sys.exit(main())
