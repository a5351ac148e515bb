"""Packet filter rules that keep environments away from the host and from networks that their users may not reach.

Every rule matches a bridge and carries a comment with its name, by which it is found again. Docker evaluates the chain
`DOCKER-USER` before its own rules and does not change it; the chain exists wherever Docker itself uses the packet
filter.
"""

from __future__ import annotations

import asyncio
import re
import shutil
import socket
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import Sequence
from typing import NamedTuple

from rce.api.egress import Egress, targets
from rce.errors import Unavailable

FORWARDED, TO_HOST = "DOCKER-USER", "INPUT"
JUMP = f"FORWARD -j {FORWARDED}"
NOT_THE_INTERNET = (  # RFC 6890: this network, private, shared, loopback, link-local (metadata of clouds), multicast
    *("0.0.0.0/8", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12", "192.0.0.0/24"),
    *("192.168.0.0/16", "198.18.0.0/15", "224.0.0.0/4", "240.0.0.0/4"),
)
ALL_BRIDGES = "rce-+"  # pattern of the bridges of environments
COMMENT = "-m comment --comment"
_RULE = re.compile(rf"-A (?P<chain>\S+) (?P<words>.*{COMMENT} (?P<bridge>rce-\w+) .*)")
PATH = "/usr/sbin:/sbin:/usr/bin:/bin"
Rule = tuple[str, ...]  # the chain, then the arguments of the rule


def group_rules(bridge: str) -> list[Rule]:
    """Return the rules of a group network: its members reach each other and nobody else.

    Multicast is included, which Docker's own rules drop on an internal network.
    """
    return [
        (FORWARDED, "-i", bridge, "-o", bridge, "-j", "ACCEPT"),
        (FORWARDED, "-i", bridge, "-j", "DROP"),
        (FORWARDED, "-o", bridge, "-j", "DROP"),
        (TO_HOST, "-i", bridge, "-j", "DROP"),
    ]


def egress_rules(bridge: str, egress: Egress) -> list[Rule]:
    """Return the rules of an egress network.

    It reaches what `egress` says, but no other environment. From outside only replies are let in.
    """
    answers = ("-m", "conntrack", "--ctstate", "ESTABLISHED,RELATED")
    rules: list[Rule] = [
        (FORWARDED, "-o", bridge, *answers, "-j", "RETURN"),
        (FORWARDED, "-o", bridge, "-j", "DROP"),
        (FORWARDED, "-i", bridge, "-o", ALL_BRIDGES, "-j", "DROP"),
    ]
    if egress == "all":
        return rules
    if listed := targets(egress):
        allowed = [("-i", bridge, "-d", host, "-p", "tcp", "--dport", port, "-j", "RETURN") for host, port in listed]
        rest = ("-i", bridge, "-j", "DROP")
        return [*rules, *((chain, *words) for chain in (FORWARDED, TO_HOST) for words in (*allowed, rest))]
    return [
        *rules,
        *((FORWARDED, "-i", bridge, "-d", network, "-j", "DROP") for network in NOT_THE_INTERNET),
        (TO_HOST, "-i", bridge, "-j", "DROP"),
    ]


class Firewall:
    """The packet filter of this machine. All calls raise Unavailable if it cannot be used."""

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._set: dict[str, list[str]] = {}  # by bridge, as `iptables -S` printed them then

    async def set_rules(self, bridge: str, rules: Sequence[Rule]) -> None:
        """Replace the rules of a bridge atomically; they come before all others of their chain."""
        if not _exists(bridge):
            raise Unavailable(
                f"Docker's bridge {bridge} is not on this machine, so it cannot be filtered: DOCKER_HOST must be a "
                "daemon of this machine and of this network namespace"
            )
        async with self._lock:
            before = [_removal(each) for each in await _present_rules() if each.bridge == bridge]
            marked = [f"-I {chain} {' '.join(words)} {COMMENT} {bridge}" for chain, *words in reversed(rules)]
            await _restore(before + marked)
            self._set[bridge] = [_line(each) for each in await _present_rules() if each.bridge == bridge]

    async def remove_rules(self, bridge: str) -> None:
        """Remove the rules of a bridge."""
        async with self._lock:
            self._set.pop(bridge, None)
            await _restore([_removal(each) for each in await _present_rules() if each.bridge == bridge])

    async def changed(self) -> bool:
        """Return True if rules that were set have been removed, or packets no longer pass them."""
        async with self._lock:
            if not self._set:
                return False
            lines = (await _run("iptables", "-S")).splitlines()
        wanted = {f"-A {JUMP}"}.union(*self._set.values())
        return not wanted.issubset(lines)

    async def restore_chain(self) -> None:
        """Create the chain for forwarded packets again, and lead them to it, as Docker did when it started."""
        async with self._lock:
            lines = (await _run("iptables", "-S")).splitlines()
            if f"-N {FORWARDED}" not in lines:
                await _run("iptables", "-N", FORWARDED)
            if f"-A {JUMP}" not in lines:
                await _run("iptables", "-I", *JUMP.split())

    async def sweep(self) -> None:
        """Remove the rules of bridges that no longer exist."""
        async with self._lock:
            await _restore([_removal(each) for each in await _present_rules() if not _exists(each.bridge)])


class _PresentRule(NamedTuple):
    """A rule of an environment's bridge as `iptables -S` prints it."""

    chain: str
    words: str
    bridge: str


async def _present_rules() -> list[_PresentRule]:
    found = []
    for line in [line for chain in (FORWARDED, TO_HOST) for line in (await _list(chain)).splitlines()]:
        match = _RULE.fullmatch(line)
        if match:
            found.append(_PresentRule(match["chain"], match["words"], match["bridge"]))
    return found


def _line(rule: _PresentRule) -> str:
    return f"-A {rule.chain} {rule.words}"


def _removal(rule: _PresentRule) -> str:
    return f"-D {rule.chain} {rule.words}"


def _exists(bridge: str) -> bool:
    try:
        socket.if_nametoindex(bridge)
    except OSError:
        return False
    return True


async def _list(chain: str) -> str:
    try:
        return await _run("iptables", "-S", chain)
    except Unavailable as error:
        if chain == FORWARDED and "failed" in str(error):
            raise Unavailable(f"{error} (Docker creates this chain unless it runs with --iptables=false)") from None
        raise


async def _restore(lines: Sequence[str]) -> None:
    if lines:
        await _run("iptables-restore", "--noflush", given="\n".join(["*filter", *lines, "COMMIT", ""]))


async def _run(name: str, *words: str, given: str = "") -> str:
    program = shutil.which(name, path=PATH)
    if program is None:
        raise Unavailable(f"networks of environments need iptables, and this machine has no {name}: install it")
    stdin = PIPE if given else DEVNULL
    process = await asyncio.create_subprocess_exec(program, "-w", "10", *words, stdin=stdin, stdout=PIPE, stderr=PIPE)
    output, error = await process.communicate(given.encode() or None)
    if process.returncode:
        reason = error.decode(errors="replace").strip().replace("\n", " ")
        raise Unavailable(f"networks of environments need iptables, and {' '.join([name, *words])} failed: {reason}")
    return output.decode()
