"""Participants of DDS whose processes were killed: the others are told, so that they need not wait for its lease.

A participant that ends in order says so to all others. For one that was killed, this process sends the same message
(RTPS 2.5: 8.5.3 participant discovery, 9.4 submessages, 9.6.2.4 ports, 9.6.4.9 status info). Fast DDS, which all ROS
processes here use, puts the process id into the identifiers of participants, and an id of the host that it derives from
the host's addresses. A participant that started while the host had other addresses than at the start of this process
is taken for one of another host: its lease of 20 s decides.
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterable
from pathlib import Path

from rclpy.node import Node

PREFIX = 12  # bytes of a gid that identify the participant
ORIGIN = 4  # bytes of the prefix that identify vendor and host; two of the process id follow, little-endian
PORT_BASE, PORTS_OF_DOMAIN, OFFSET, PORTS_OF_PARTICIPANT = 7400, 250, 10, 2  # of unicast discovery
PARTICIPANTS = 32  # of one host that are told
PARTICIPANT = bytes((0, 0, 1, 0xC1))  # entity ids
READER, WRITER = bytes((0, 1, 0, 0xC7)), bytes((0, 1, 0, 0xC2))
KEY_HASH, STATUS_INFO, SENTINEL = 0x70, 0x71, 1  # parameters
DISPOSED_AND_UNREGISTERED = bytes((0, 0, 0, 3))
DATA, LITTLE_ENDIAN, INLINE_QOS = 0x15, 1, 2  # submessage and its flags
LAST_NUMBER = 0x7FFF_FFFF  # above the sequence numbers of all messages that the participant has sent


def tell_of_dead(node: Node, own: bytes, addresses: Iterable[str]) -> int:
    """Tell all participants at these IPv4 addresses of those on this host that have no process any more.

    Args:
        node: A node of this process.
        own: Prefix of this process's participant.
        addresses: Addresses of the hosts, also of this one.

    Returns:
        The number of dead participants.
    """
    dead = {prefix for prefix in _participants(node) if prefix[:ORIGIN] == own[:ORIGIN] and not _has_process(prefix)}
    first = PORT_BASE + PORTS_OF_DOMAIN * node.context.get_domain_id() + OFFSET
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for prefix in dead:
            data = farewell(prefix)
            for address in addresses:
                for number in range(PARTICIPANTS):
                    _send(sender, data, address, first + PORTS_OF_PARTICIPANT * number)
    return len(dead)


def farewell(prefix: bytes) -> bytes:
    """Return the message with which a participant leaves."""
    qos = struct.pack("<HH", KEY_HASH, 16) + prefix + PARTICIPANT
    qos += struct.pack("<HH", STATUS_INFO, 4) + DISPOSED_AND_UNREGISTERED + struct.pack("<HH", SENTINEL, 0)
    body = struct.pack("<HH", 0, 16) + READER + WRITER + struct.pack("<iI", 0, LAST_NUMBER) + qos
    head = b"RTPS" + bytes((2, 3)) + prefix[:2] + prefix
    return head + struct.pack("<BBH", DATA, LITTLE_ENDIAN | INLINE_QOS, len(body)) + body


def _participants(node: Node) -> set[bytes]:
    """Return the prefixes of all participants with a publisher or subscription."""
    return {
        bytes(info.endpoint_gid)[:PREFIX]
        for topic, _ in node.get_topic_names_and_types()
        for info in (*node.get_publishers_info_by_topic(topic), *node.get_subscriptions_info_by_topic(topic))
    }


def _has_process(prefix: bytes) -> bool:
    """Return True if a process on this host may be that of a participant: the lower half of its id is the same."""
    half = int.from_bytes(prefix[ORIGIN : ORIGIN + 2], "little")
    return any(_runs(pid) for pid in map(int, filter(str.isdigit, os.listdir("/proc"))) if pid & 0xFFFF == half)


def _runs(pid: int) -> bool:
    """Return True unless a process has ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def _send(sender: socket.socket, data: bytes, address: str, port: int) -> None:
    try:
        sender.sendto(data, (address, port))
    except OSError:
        return  # no such host or process: nobody to be told
