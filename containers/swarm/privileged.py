"""`python -P -m containers.swarm.privileged`: apply limits to an environment, for which an agent lacks the privileges.

The agent runs this program through Docker in a short-lived container that sees all processes and devices of the node.
The variable `RCE_LIMITS` has the request; an error is printed on the last line as JSON.
"""

from __future__ import annotations

import os
import subprocess
import sys

import msgspec

from containers.agents.outside_limits import LimitRequest, apply
from rce.errors import RceError, StartFailed

COMMAND = ["python3", "-P", "-m", "containers.swarm.privileged"]
REQUEST_VARIABLE = "RCE_LIMITS"


def main() -> int:
    """Apply the requested limits; return the exit status."""
    try:
        apply(msgspec.json.decode(os.environ[REQUEST_VARIABLE], type=LimitRequest))
    except RceError as error:
        print(msgspec.json.encode(error.info).decode(), flush=True)
        return 1
    except (OSError, subprocess.CalledProcessError) as error:
        print(msgspec.json.encode(StartFailed(str(error)).info).decode(), flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
