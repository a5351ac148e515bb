"""Network of a pod, closed or filtered from outside.

A pod always has a network, and whether the cluster enforces a NetworkPolicy depends on its network plugin. So the agent
changes the pod's own network namespace before the endpoint gets its socket to the Master, thus before any program of a
user runs. The environment cannot change it back, as it has no capabilities. All functions block.

Without egress and group, the interfaces are down. With egress, a packet filter in the namespace lets in only replies,
and out only what the user may reach. The network of a group is a VXLAN (RFC 7348) between the addresses of its members'
pods; the filter lets its packets pass to and from these addresses only. IPv6 is switched off.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Collection, Iterable
from ipaddress import ip_interface

from containers.docker.firewall import NOT_THE_INTERNET
from containers.docker.shaping import PATH, devices
from containers.kubernetes.objects import identity
from rce.api.egress import Egress, targets
from rce.control.calls.environments import Group
from rce.errors import StartFailed

GROUP_DEVICE = "rce-group"
GROUP_PORT = 4789  # UDP, of VXLAN
ANY_STATION = "00:00:00:00:00:00"  # entry of the forwarding database for frames to unknown stations and to many
REPLIES = "-m conntrack --ctstate ESTABLISHED,RELATED -j ACCEPT"
NO_IPV6 = (
    'for each in /proc/sys/net/ipv6/conf/*; do case $each in */lo) ;; *) echo 1 > "$each/disable_ipv6";; esac; done'
)


def confine(process: int, egress: Egress, group: Group | None) -> None:
    """Close or filter the network of a pod, given its first process.

    Raises:
        StartFailed: A program failed, so the network may be open.
    """
    if egress == "none" and group is None:
        for device in devices(process):
            _inside(process, "ip", "link", "set", "dev", device, "down")
        return
    _inside(process, "sh", "-c", NO_IPV6)
    _set_rules(process, egress, group, [])
    if group is not None:
        _make_tunnel(process, group)


def connect(process: int, egress: Egress, group: Group, peers: Collection[str]) -> None:
    """Connect a pod to the pods of its group with these addresses, and to no other.

    Raises:
        StartFailed: A program failed.
    """
    _set_rules(process, egress, group, peers)
    shown = _inside(process, "bridge", "fdb", "show", "dev", GROUP_DEVICE)
    present = {line.split()[line.split().index("dst") + 1] for line in shown.splitlines() if _is_flooded(line)}
    for action, addresses in (("append", set(peers) - present), ("del", present - set(peers))):
        for address in sorted(addresses):
            _inside(process, "bridge", "fdb", action, ANY_STATION, "dev", GROUP_DEVICE, "dst", address)


def rules(egress: Egress, peers: Iterable[str], *, group: bool) -> str:
    """Return the packet filter of a pod in the form of `iptables-restore`."""
    lines = [
        "*filter",
        ":INPUT DROP",
        ":FORWARD DROP",
        ":OUTPUT DROP",
        "-A INPUT -i lo -j ACCEPT",
        "-A OUTPUT -o lo -j ACCEPT",
    ]
    if group:
        lines += [f"-A INPUT -i {GROUP_DEVICE} -j ACCEPT", f"-A OUTPUT -o {GROUP_DEVICE} -j ACCEPT"]
    for peer in sorted(peers):
        tunnel = f"-p udp -m udp --dport {GROUP_PORT} -j ACCEPT"
        lines += [f"-A INPUT -s {peer}/32 {tunnel}", f"-A OUTPUT -d {peer}/32 {tunnel}"]
    if egress != "none":
        lines.append(f"-A INPUT {REPLIES}")
    if egress == "internet":
        lines += [f"-A OUTPUT -d {network} -j REJECT" for network in NOT_THE_INTERNET]
    lines += [f"-A OUTPUT -d {host} -p tcp -m tcp --dport {port} -j ACCEPT" for host, port in targets(egress)]
    lines.append(f"-A OUTPUT -j {'ACCEPT' if egress in ('internet', 'all') else 'REJECT'}")
    return "\n".join([*lines, "COMMIT", ""])


def _set_rules(process: int, egress: Egress, group: Group | None, peers: Collection[str]) -> None:
    _inside(process, "iptables-restore", given=rules(egress, peers, group=group is not None))


def _make_tunnel(process: int, group: Group) -> None:
    if GROUP_DEVICE in devices(process):  # this agent's predecessor made it
        return
    number = str(int(identity(group.name), 16) % 2**24)
    words = ["link", "add", GROUP_DEVICE, "type", "vxlan", "id", number, "dstport", str(GROUP_PORT)]
    _inside(process, "ip", *words)
    prefix = group.subnet.partition("/")[2]
    address = str(ip_interface(f"{group.address}/{prefix}"))
    _inside(process, "ip", "address", "add", address, "dev", GROUP_DEVICE)
    _inside(process, "ip", "link", "set", GROUP_DEVICE, "up")


def _is_flooded(line: str) -> bool:
    return line.startswith(ANY_STATION) and " dst " in line


def _inside(process: int, name: str, *words: str, given: str = "") -> str:
    """Run a program of the agent in the network namespace of a process; return its output."""
    program = shutil.which(name, path=PATH) or name
    command = ["nsenter", f"--net=/proc/{process}/ns/net", program, *words]
    done = subprocess.run(command, input=given, capture_output=True, text=True)
    if done.returncode:
        raise StartFailed(f"the network of its pod cannot be set up: {name}: {done.stderr.strip()}")
    return done.stdout
