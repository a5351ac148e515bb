"""All that the API offers, one file for each family of resources."""

from __future__ import annotations

from master.api.environments import EnvironmentsApi
from master.api.interfaces import InterfacesApi
from master.api.machines import MachinesApi
from master.api.packages import PackagesApi
from master.api.robots import RobotsApi
from master.api.ros import RosApi
from master.api.router import Api
from master.depot import Depot
from master.service import Master


def make_api(master: Master, depot: Depot) -> Api:
    """The API of this Master."""
    api = Api(master.users)
    for family in (RobotsApi, EnvironmentsApi, InterfacesApi, MachinesApi, RosApi):
        family(master).add_to(api)
    PackagesApi(master, depot).add_to(api)
    return api
