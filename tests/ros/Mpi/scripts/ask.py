#!/usr/bin/env python3
"""`ask.py HOST COMMAND…`: has a member of the group run a command, as `ssh` would; Open MPI's `plm_ssh_agent`."""

from __future__ import annotations

import socket
import sys

from member import PORT

if __name__ == "__main__":
    with socket.create_connection((sys.argv[1], PORT), 10) as line:
        line.settimeout(None)
        line.sendall(" ".join(sys.argv[2:]).encode() + b"\n")
        while output := line.recv(4096):
            sys.stdout.buffer.write(output)
            sys.stdout.buffer.flush()
