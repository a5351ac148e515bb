"""Network namespaces, by the program `ip` of iproute2."""

from __future__ import annotations

import ctypes
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from rce.errors import Unavailable

CLONE_NEWNET = 0x40000000
IP = "ip"


def ip(*words: str) -> str:
    """Run `ip`; return its output.

    Raises:
        Unavailable: It is not installed, or failed; its message tells the reason.
    """
    try:
        return subprocess.run([IP, *words], check=True, capture_output=True, text=True).stdout
    except FileNotFoundError:
        raise Unavailable("the program ip is not there: install the package iproute2") from None
    except subprocess.CalledProcessError as error:
        raise Unavailable(f"{' '.join([IP, *words])}: {error.stderr.strip()}") from None


@contextmanager
def entered(name: str) -> Iterator[None]:
    """Move this thread to a network namespace during the block.

    Raises:
        OSError: The namespace does not exist, or this process may not enter it.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    with open("/proc/thread-self/ns/net") as before, open(f"/run/netns/{name}") as target:
        _enter(libc, target.fileno())
        try:
            yield
        finally:
            _enter(libc, before.fileno())


def _enter(libc: ctypes.CDLL, namespace: int) -> None:
    if libc.setns(namespace, CLONE_NEWNET):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
