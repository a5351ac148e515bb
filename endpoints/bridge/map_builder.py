"""Maps of a robot's recordings, built by the platform's map service and published at the robot."""

from __future__ import annotations

import asyncio
import tempfile
from contextlib import ExitStack
from pathlib import Path

import msgspec

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.bridge.config import BridgeConfig, BuildMap
from endpoints.bridge.local_ros import CLOUD, CloudLink, LocalRos
from endpoints.data.frames import Message
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.topics import PublisherInterface
from rce.api.map_jobs import MapOptions
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest, RceError
from rce.mapping.files.maps import read_map
from rce.mapping.grid import OccupancyGrid
from rce.protocol.messages import Qos
from rce.protocol.names import parse_type

GRID = "nav_msgs/OccupancyGrid"
LATCHED = Qos(reliability="reliable", durability="transient_local", depth=1)


class MapBuilder:
    """Sends recordings to the map service and publishes the maps, latched."""

    def __init__(self, config: BridgeConfig, local: LocalRos) -> None:
        self._config = config
        self._local = local
        self._topics: dict[str, RosInterface] = {}

    async def build(self, recording: Path, action: BuildMap) -> str:
        """Build and publish the map of a recording; return a sentence about it.

        Raises:
            InvalidRequest: The recording cannot be read, or the files of the map cannot be written.
            RceError: The map service refused the recording, or could not build a map of it.
        """
        with ExitStack() as stack:
            directory = action.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rce-bridge-")))
            try:
                scans, grid = await asyncio.to_thread(self._build, recording, action, directory)
            except OSError as error:
                raise InvalidRequest(f"cannot build a map of {recording} in {directory}: {error}") from None
            await self._publish(action.topic, grid)
            where = f", and its files are in {directory}" if action.out else ""
            return f"a map of {scans} scans is published on {action.topic}{where}"

    def _build(self, recording: Path, action: BuildMap, directory: Path) -> tuple[int, OccupancyGrid]:
        config = self._config
        service = MapServiceClient(config.url, user=config.user, password=config.password, key=config.key)
        files = sorted(path for path in recording.iterdir() if path.is_file())
        uploads = [service.upload(path, lambda _: None).id for path in files]
        options = MapOptions(mapper=action.mapper, scan_topic=action.scan, odometry_topic=action.odometry)
        job = list(service.watch(service.submit(uploads, options, recording.name).id))[-1]
        if job.error is not None:
            raise RceError.from_info(job.error)
        if job.state != "done":
            raise RceError(f"job {job.id} of the map service is {job.state}, not done")
        directory.mkdir(parents=True, exist_ok=True)
        for file in job.files:
            service.fetch(job.id, file.name, directory / file.name)
        return job.scans, read_map(directory / "map.yaml")

    async def _publish(self, topic: str, grid: OccupancyGrid) -> None:
        if topic not in self._topics:
            self._topics[topic] = await self._local.add_interface(PublisherInterface, GRID, topic, CloudLink(), LATCHED)
        height, width = grid.cells.shape
        origin = {"position": {"x": grid.x, "y": grid.y}}
        value = {
            "header": {"frame_id": "map"},
            "info": {"resolution": grid.resolution, "width": width, "height": height, "origin": origin},
            "data": grid.cells.ravel().tolist(),
        }
        cdr = TypeRegistry().message(parse_type(GRID)).encode(Wire(False, msgspec.json.encode(value), {}))
        self._topics[topic].receive(Message(CLOUD, "", cdr), CloudLink())
