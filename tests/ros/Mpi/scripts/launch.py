#!/usr/bin/env python3
"""Runs `ranks.py` on the members named in the arguments, by Open MPI, and publishes what it prints on /mpi."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String

HERE = Path(__file__).parent
ATTEMPTS = 10  # the other members' nodes may still be starting


def run(hosts: list[str]) -> str:
    network = f"{os.environ['RCE_GROUP_IP']}/24"
    settings = {
        "--prtemca": {
            "plm_ssh_agent": f"{sys.executable} {HERE / 'ask.py'}",
            "plm_ssh_no_tree_spawn": "1",
            "prte_if_include": network,
        },
        "--mca": {"pml": "ob1", "btl": "tcp,self", "btl_tcp_if_include": network},
    }
    options = [word for kind, each in settings.items() for item in each.items() for word in (kind, *item)]
    program = [sys.executable, str(HERE / "ranks.py")]
    command = ["mpirun", *options, "--host", ",".join(hosts), "-n", str(len(hosts)), *program]
    for _ in range(ATTEMPTS):
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        if done.returncode == 0:
            break
        time.sleep(1)
    return done.stdout.strip().rpartition("\n")[2]  # before it stand warnings about the shell


if __name__ == "__main__":
    rclpy.init()
    node = rclpy.create_node("launch")
    publisher = node.create_publisher(String, "/mpi", 1)
    said = run(remove_ros_args(sys.argv)[1:])
    print(said, flush=True)
    node.create_timer(0.5, lambda: publisher.publish(String(data=said)))
    rclpy.spin(node)
