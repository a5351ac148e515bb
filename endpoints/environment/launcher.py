"""Run as a program: becomes the command in its arguments, which dies with the process that started it.

    launcher.py PARENT REPORT COMMAND…

PARENT is the pid of the process that starts it; REPORT a file descriptor, which is closed when the command runs, and
gets the reason when it cannot. Run with `-I -S`, it is up in some 10 ms.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def main() -> None:
    parent, report, command = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it died before
        sys.exit(1)
    os.set_inheritable(report, False)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        os.write(report, f"{command[0]}: {error.strerror}".encode())
        sys.exit(1)


if __name__ == "__main__":
    main()
