"""Stand-in for the Environment endpoint that needs no ROS: `python stand_in.py [BEHAVIOUR]`.

On SIGUSR1 it prints its last words and ends with status 3. It writes its environment variables and other facts to
`seen.json` in its directory. With the behaviour `child` it starts a child in a process group of its own, as nodes are;
with `stubborn` it ignores SIGTERM.
"""

import json
import os
import signal
import subprocess
import sys


def end(*_: object) -> None:
    print("last words", flush=True)
    os._exit(3)


def main() -> None:
    behaviour = sys.argv[1] if len(sys.argv) > 1 else ""
    signal.signal(signal.SIGUSR1, end)
    if behaviour == "stubborn":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    wake, child = signal.set_wakeup_fd(-1), 0
    if behaviour == "child":
        child = subprocess.Popen(["sleep", "1000"], start_new_session=True).pid
    with open("seen.new", "w") as seen:
        json.dump({"environ": dict(os.environ), "child": child, "wake": wake}, seen)
    os.rename("seen.new", "seen.json")
    while True:
        signal.pause()


main()
