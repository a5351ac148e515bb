#!/usr/bin/env python3
"""Runs what other members of the group ask for, which is how Open MPI starts its daemons there: in place of sshd.

The network of a group is its user's alone, so whoever gets here may do what the user may do in any of its environments.
"""

from __future__ import annotations

import os
import socketserver
import subprocess

PORT = 7100


class Request(socketserver.StreamRequestHandler):
    """One line is a command for the shell; its output goes back."""

    def handle(self) -> None:
        command = self.rfile.readline().decode()
        subprocess.run(["sh", "-c", command], stdout=self.connection, stderr=subprocess.STDOUT, check=False)


class Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True


if __name__ == "__main__":
    Server((os.environ["RCE_GROUP_IP"], PORT), Request).serve_forever()
