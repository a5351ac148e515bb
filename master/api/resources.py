"""Assembly of the API out of its families of resources, one module each."""

from __future__ import annotations

from master.access.enrolment import Inviter
from master.api.audit import AuditApi
from master.api.catalogue import CatalogueApi
from master.api.environments import EnvironmentsApi
from master.api.events import EventsApi
from master.api.interfaces import InterfacesApi
from master.api.jobs import JobsApi
from master.api.keys import KeysApi
from master.api.live import LiveFeed
from master.api.logs import LogsApi
from master.api.machines import MachinesApi
from master.api.monitoring import Monitoring
from master.api.openapi import OpenApi
from master.api.packages import PackagesApi
from master.api.recorders import RecordersApi
from master.api.recordings import RecordingsApi
from master.api.robots import RobotsApi
from master.api.ros import RosApi
from master.api.router import Api
from master.api.secrets import SecretsApi
from master.api.services import ServicesApi
from master.api.streams import EventStreams
from master.api.traces import TracesApi
from master.api.users import UsersApi
from master.service import Master
from master.storage.depot import Depot


def make_api(master: Master, depot: Depot, inviter: Inviter | None = None) -> Api:
    """Return the API of this Master; without an inviter no machines can be invited."""
    api = Api(master.users, master.audit, lambda: master.state.removed_users)
    families = (
        *(UsersApi, KeysApi, AuditApi, RobotsApi, EnvironmentsApi, RecordersApi, RecordingsApi),
        *(InterfacesApi, RosApi, JobsApi, ServicesApi),
    )
    for family in families:
        family(master).add_to(api)
    MachinesApi(master, inviter).add_to(api)
    PackagesApi(master, depot).add_to(api)
    CatalogueApi(master).add_to(api)
    SecretsApi(master).add_to(api)
    streams = EventStreams(master.guard)
    EventsApi(master, streams).add_to(api)
    LogsApi(master, streams).add_to(api)
    TracesApi(master, streams).add_to(api)
    OpenApi().add_to(api)
    Monitoring(master).add_to(api)
    live = LiveFeed(master)
    api.mount("/live", live.handle)
    api.on_stop += [streams.stop, live.stop]
    return api
