"""Prints its arguments and what it can see, starts a child, and ends or goes on as its first argument says."""

import importlib
import os
import subprocess
import sys
import time


def visible(name: str) -> bool:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        return False
    return True


print("arguments", sys.argv[1 : sys.argv.index("--ros-args")])
print("sees", [name for name in ("rclpy", "rce", "endpoints", "tests") if visible(name)])
print("secrets", [name for name in os.environ if name.startswith("RCE_")], os.getcwd())
if sys.argv[1] == "die":
    sys.exit(3)
child = subprocess.Popen(["sleep", "60"])
print("pids", os.getpid(), child.pid, flush=True)
if sys.argv[1] == "deaf":
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    print("deaf to SIGINT", flush=True)
time.sleep(60)
