"""`/api/v1/environments`, and the nodes and parameters below."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master import rights
from master.api.acting import acting, listing, page, principal
from master.api.calls import Answer, Call, Listing, One, Paging, Whose
from master.api.router import Api, Route
from master.records import Environment, user_of
from master.service import Master
from rce.errors import NotFound
from rce.views import EnvironmentView, NodeView, Page, ParameterView
from rce.views.resources import EnvironmentState

AT = "/environments/{environment}"


class Environments(Listing, frozen=True, forbid_unknown_fields=True):
    """Which environments."""

    machine: Annotated[str | None, Meta(description="those on this machine; empty: those that wait for one")] = None
    state: EnvironmentState | None = None
    group: Annotated[str, Meta(description="those in this network group")] = ""


class Inside(Paging, frozen=True, forbid_unknown_fields=True):
    """A part of what is in one environment."""

    user: Whose = ""


class Parameters(Inside, frozen=True, forbid_unknown_fields=True):
    """Which parameters."""

    node: Annotated[str | None, Meta(description="those of this node alone; empty: of the environment")] = None


class OneParameter(One, frozen=True, forbid_unknown_fields=True):
    """Whose parameter."""

    node: Annotated[str, Meta(description="the node whose own it is; empty: the environment's")] = ""


class EnvironmentsApi:
    """Environments, nodes, parameters."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state

    def add_to(self, api: Api) -> None:
        parameter = AT + "/parameters/{name}"
        api.add(
            Route("GET", "/environments", self.list, "Environments", Environments, answer=Page[EnvironmentView]),
            Route("GET", AT, self.show, "An environment", One, answer=EnvironmentView),
            Route("GET", AT + "/nodes", self.nodes, "Its nodes", Inside, answer=Page[NodeView]),
            Route("GET", AT + "/nodes/{node}", self.node, "A node", One, answer=NodeView),
            Route("GET", AT + "/parameters", self.parameters, "Its parameters", Parameters, answer=Page[ParameterView]),
            Route("GET", parameter, self.parameter, "A parameter", OneParameter, answer=ParameterView),
        )

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Environments)
        user = listing(call, "environment.read", asked.user)

        def keep(each: EnvironmentView) -> bool:
            return (
                rights.may(principal(call), "environment.read", each.user, environment=each.containerTag)
                and asked.machine in (None, each.machine)
                and asked.state in (None, each.state)
                and asked.group in ("", each.containerData.group)
            )

        return page(self._state.environments, user, asked, self._master.shown.environment, keep)

    async def show(self, call: Call) -> Answer:
        return Answer(self._master.shown.environment(self._environment(call, "environment.read", call.asked(One).user)))

    async def nodes(self, call: Call) -> Answer:
        asked = call.asked(Inside)
        environment = self._environment(call, "node.read", asked.user)
        records = self._state.nodes.by(environment.name)
        return page(records, user_of(environment.name), asked, self._master.shown.node)

    async def node(self, call: Call) -> Answer:
        environment = self._environment(call, "node.read", call.asked(One).user)
        node = self._state.nodes.get(f"{environment.name}/{call.path['node']}")
        if node is None:
            raise NotFound(f"there is no node {call.path['node'][:80]!r}", field="node")
        return Answer(self._master.shown.node(node))

    async def parameters(self, call: Call) -> Answer:
        asked = call.asked(Parameters)
        environment = self._environment(call, "parameter.read", asked.user)
        records = self._state.parameters.by(environment.name)
        shown = self._master.shown.parameter
        return page(records, user_of(environment.name), asked, shown, lambda each: asked.node in (None, each.nodeTag))

    async def parameter(self, call: Call) -> Answer:
        asked, name = call.asked(OneParameter), call.path["name"]
        environment = self._environment(call, "parameter.read", asked.user)
        parameter = self._state.parameters.get(f"{environment.name}/{asked.node}:{name}")
        if parameter is None:
            raise NotFound(f"there is no parameter {name[:80]!r}", field="name")
        return Answer(self._master.shown.parameter(parameter))

    def _environment(self, call: Call, operation: str, user: str) -> Environment:
        """The environment of the path. NotFound."""
        tag = call.path["environment"]
        environment = self._state.environments.get(f"{acting(call, operation, user, environment=tag)}/{tag}")
        if environment is None:
            raise NotFound(f"there is no environment {tag[:80]!r}", field="environment")
        return environment
