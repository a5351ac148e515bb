"""The program of a bridge: `python -P -m endpoints.bridge`."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from collections.abc import Coroutine
from pathlib import Path

from twisted.internet.base import ReactorBase

from endpoints.bridge.config import BridgeConfig, read
from rce import loop
from rce.errors import InvalidRequest
from rce.up import default_typesupport

PROGRAM = "rce bridge"
NODE = "rce_bridge"


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Carry topics, services and transforms of this robot's ROS 2 to an environment of the platform "
        "and back, as CONFIG says.",
        epilog="The ROS domain is that of ROS_DOMAIN_ID, as for every node. docs/bridge.md describes CONFIG.",
    )
    whole.add_argument("config", type=Path, metavar="CONFIG", help="YAML or JSON")
    whole.add_argument("--check", action="store_true", help="only say whether CONFIG is right")
    whole.add_argument(
        "--typesupport",
        default=default_typesupport(),
        metavar="DIRS",
        help="directories with built type support, comma-separated (default: what provisioning has built)",
    )
    return whole


async def serve(reactor: ReactorBase, config: BridgeConfig, typesupport: list[Path]) -> None:
    """Until cancelled, or until the platform refuses what the file wants."""
    from endpoints.bridge.actions import Actions  # they load ROS 2
    from endpoints.bridge.ends import LocalRos
    from endpoints.bridge.metrics import told
    from endpoints.bridge.requests import Desk
    from endpoints.environment.ros import RosThread

    ros = RosThread(asyncio.get_running_loop(), NODE)
    await ros.start()
    local = LocalRos(ros, [*typesupport, *_system_prefixes(), Path(sys.prefix)])
    actions = Actions(config, local)
    desk = Desk(config.requests, actions.perform)
    try:
        with told(reactor, config.metrics, local.families):
            if config.requests:
                await desk.open(local)
            if config.offload:
                await actions.offloading.start()
            await actions.offloading.failed
    finally:
        desk.close()
        await actions.close()
        local.close()
        await ros.stop()


def _system_prefixes() -> list[Path]:
    return [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]


def main() -> int:
    words = parser().parse_args()
    try:
        config = read(words.config)
    except InvalidRequest as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2
    if words.check:
        print(f"{words.config} is right")
        return 0
    typesupport = [Path(entry) for entry in words.typesupport.split(",") if entry]
    sys.path += [str(prefix / "python") for prefix in typesupport]

    def run(reactor: ReactorBase) -> Coroutine[None, None, None]:
        return serve(reactor, config, typesupport)

    return loop.run(run)


if __name__ == "__main__":
    sys.exit(main())
