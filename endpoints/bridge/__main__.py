"""Entry point of a bridge: `python -P -m endpoints.bridge`."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from endpoints.bridge.config import BridgeConfig, read
from rce.errors import InvalidRequest
from rce.process import loop
from rce.process.up import default_typesupport

PROGRAM = "rce bridge"
NODE = "rce_bridge"


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Forward topics, services and transforms between this robot's ROS 2 and an environment of the "
        "platform, as configured in CONFIG.",
        epilog="ROS_DOMAIN_ID selects the ROS domain, as for every node. docs/bridge.md describes CONFIG.",
    )
    result.add_argument("config", type=Path, metavar="CONFIG", help="configuration file, YAML or JSON")
    result.add_argument("--check", action="store_true", help="validate CONFIG and exit")
    result.add_argument(
        "--typesupport",
        default=default_typesupport(),
        metavar="DIRS",
        help="directories with type support, comma-separated (default: those that provisioning has built)",
    )
    return result


async def serve(config: BridgeConfig, typesupport: list[Path]) -> None:
    """Run until cancelled, or until the platform rejects something that the configuration needs.

    Args:
        config: Configuration of the bridge.
        typesupport: Prefixes with type support.

    Raises:
        RceError: The reason of the rejection.
    """
    from endpoints.bridge.actions import Actions  # these load ROS 2
    from endpoints.bridge.local_ros import LocalRos
    from endpoints.bridge.metrics import serve_metrics
    from endpoints.bridge.requests import RequestServer
    from endpoints.environment.ros import Ros

    ros = Ros(NODE)
    local = LocalRos(ros, [*typesupport, *_system_prefixes(), Path(sys.prefix)])
    actions = Actions(config, local)
    requests = RequestServer(config.requests, actions.perform)
    try:
        async with serve_metrics(config.metrics, local.families):
            if config.requests:
                await requests.open(local)
            if config.offload:
                await actions.offloading.start()
            await actions.offloading.failed
    finally:
        requests.close()
        await actions.close()
        local.close()
        ros.close()


def _system_prefixes() -> list[Path]:
    return [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]


def main() -> int:
    """Run the program; return its exit status."""
    arguments = parser().parse_args()
    try:
        config = read(arguments.config)
    except InvalidRequest as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2
    if arguments.check:
        print(f"{arguments.config} is valid")
        return 0
    typesupport = [Path(entry) for entry in arguments.typesupport.split(",") if entry]
    sys.path += [str(prefix / "python") for prefix in typesupport]
    return loop.run(lambda _: serve(config, typesupport))


if __name__ == "__main__":
    sys.exit(main())
