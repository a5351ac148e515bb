"""`/api/v1/environments`, and the nodes and parameters below."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from master import rights
from master.api.acting import acting, listing, page, principal
from master.api.calls import Answer, Call, Listing, One, Paging, Whose
from master.api.commands import Commands, created
from master.api.router import Api, Route
from master.records import Environment, Node, user_of
from master.service import Master
from rce import messages as m
from rce.errors import NotFound
from rce.views import EnvironmentView, NewEnvironment, NewNode, NewParameter, NodeView, Page, ParameterView
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
        self._commands = Commands(master)

    def add_to(self, api: Api) -> None:
        nodes, node = AT + "/nodes", AT + "/nodes/{node}"
        parameters, parameter = AT + "/parameters", AT + "/parameters/{name}"
        started = "Start an environment; answered when it is ready"
        api.add(
            Route("GET", "/environments", self.list, "Environments", Environments, answer=Page[EnvironmentView]),
            Route("POST", "/environments", self.create, started, One, NewEnvironment, EnvironmentView, 201),
            Route("GET", AT, self.show, "An environment", One, answer=EnvironmentView),
            Route(
                "DELETE", AT, self.remove, "Stop it, with all that is in it; answered when it is gone", One, status=204
            ),
            Route("GET", nodes, self.nodes, "Its nodes", Inside, answer=Page[NodeView]),
            Route("POST", nodes, self.add_node, "Start a node; answered when it runs", One, NewNode, NodeView, 201),
            Route("GET", node, self.node, "A node", One, answer=NodeView),
            Route("DELETE", node, self.remove_node, "Stop a node; answered when it has ended", One, status=204),
            Route("GET", parameters, self.parameters, "Its parameters", Parameters, answer=Page[ParameterView]),
            Route("POST", parameters, self.set_parameter, "Set a parameter", One, NewParameter, ParameterView),
            Route("GET", parameter, self.parameter, "A parameter", OneParameter, answer=ParameterView),
            Route("DELETE", parameter, self.remove_parameter, "Forget a parameter", OneParameter, status=204),
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

    async def create(self, call: Call) -> Answer:
        wanted = call.body(NewEnvironment)
        command = m.CreateContainer(wanted.containerTag, wanted.containerData)
        owner = await self._commands.execute(call, call.asked(One).user, command)
        environment = self._state.environments.get(f"{owner}/{wanted.containerTag}")
        if environment is None:
            raise NotFound(f"environment {wanted.containerTag} was removed again", field="environment")
        return created(call, owner, self._master.shown.environment(environment), "environments", wanted.containerTag)

    async def remove(self, call: Call) -> Answer:
        await self._commands.execute(call, call.asked(One).user, m.DestroyContainer(call.path["environment"]))
        return Answer(status=204)

    async def show(self, call: Call) -> Answer:
        return Answer(self._master.shown.environment(self._environment(call, "environment.read", call.asked(One).user)))

    async def nodes(self, call: Call) -> Answer:
        asked = call.asked(Inside)
        environment = self._environment(call, "node.read", asked.user)
        records = self._state.nodes.by(environment.name)
        return page(records, user_of(environment.name), asked, self._master.shown.node)

    async def add_node(self, call: Call) -> Answer:
        tag, wanted = call.path["environment"], call.body(NewNode)
        command = m.AddNode(tag, **msgspec.structs.asdict(wanted))
        owner = await self._commands.execute(call, call.asked(One).user, command)
        view = self._master.shown.node(self._node(owner, tag, wanted.nodeTag))
        return created(call, owner, view, "environments", tag, "nodes", wanted.nodeTag)

    async def remove_node(self, call: Call) -> Answer:
        command = m.RemoveNode(call.path["environment"], call.path["node"])
        await self._commands.execute(call, call.asked(One).user, command)
        return Answer(status=204)

    async def node(self, call: Call) -> Answer:
        environment = self._environment(call, "node.read", call.asked(One).user)
        return Answer(
            self._master.shown.node(self._node(user_of(environment.name), call.path["environment"], call.path["node"]))
        )

    def _node(self, owner: str, environment: str, tag: str) -> Node:
        node = self._state.nodes.get(f"{owner}/{environment}/{tag}")
        if node is None:
            raise NotFound(f"{environment} has no node {tag[:80]!r}", field="node")
        return node

    async def parameters(self, call: Call) -> Answer:
        asked = call.asked(Parameters)
        environment = self._environment(call, "parameter.read", asked.user)
        records = self._state.parameters.by(environment.name)
        shown = self._master.shown.parameter
        return page(records, user_of(environment.name), asked, shown, lambda each: asked.node in (None, each.nodeTag))

    async def set_parameter(self, call: Call) -> Answer:
        tag, wanted = call.path["environment"], call.body(NewParameter)
        command = m.SetParameter(tag, wanted.name, wanted.value, wanted.nodeTag)
        owner = await self._commands.execute(call, call.asked(One).user, command)
        return Answer(ParameterView(owner, tag, wanted.nodeTag, wanted.name, wanted.value))

    async def remove_parameter(self, call: Call) -> Answer:
        asked = call.asked(OneParameter)
        command = m.DeleteParameter(call.path["environment"], call.path["name"], asked.node)
        await self._commands.execute(call, asked.user, command)
        return Answer(status=204)

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
