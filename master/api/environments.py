"""`/api/v1/environments`, and the nodes and parameters below each."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from master.access import rights
from master.api.commands import Commands, created
from master.api.principals import authorize_list, find_environment, page_of_records, page_of_views, principal_of
from master.api.request import Answer, Call, ListQuery, Owner, OwnerQuery, PageQuery
from master.api.router import Api, Route
from master.graph.records import Node, user_of
from master.service import Master
from rce.api.views import EnvironmentView, NewEnvironment, NewNode, NewParameter, NodeView, Page, ParameterView
from rce.api.views.resources import EnvironmentState
from rce.errors import NotFound
from rce.protocol import messages as m
from rce.spelling import tags, unknown

AT = "/environments/{environment}"


class Environments(ListQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of environments."""

    machine: Annotated[str | None, Meta(description="on this machine; empty: not placed yet")] = None
    state: EnvironmentState | None = None
    group: Annotated[str, Meta(description="in this network group")] = ""


class ContentQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a list of what is in one environment."""

    user: Owner = ""


class NodesQuery(ContentQuery, frozen=True, forbid_unknown_fields=True):
    """Filter of nodes."""

    all: Annotated[bool, Meta(description="those too that have ended and are not started again")] = False


class ParametersQuery(ContentQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of parameters."""

    node: Annotated[str | None, Meta(description="of this node; empty: of the environment itself")] = None


class ParameterQuery(OwnerQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a request for one parameter."""

    node: Annotated[str, Meta(description="node that it belongs to; empty: the environment")] = ""


class EnvironmentsApi:
    """Routes of environments, nodes and parameters."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._commands = Commands(master)

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        nodes, node = AT + "/nodes", AT + "/nodes/{node}"
        parameters, parameter = AT + "/parameters", AT + "/parameters/{name}"
        started = "Start an environment; the answer comes when it is ready"
        api.add(
            Route("GET", "/environments", self._list, "Environments", Environments, answer=Page[EnvironmentView]),
            Route("POST", "/environments", self._create, started, OwnerQuery, NewEnvironment, EnvironmentView, 201),
            Route("GET", AT, self._show, "An environment", OwnerQuery, answer=EnvironmentView),
            Route(
                "DELETE",
                AT,
                self._remove,
                "Stop an environment with all that is in it; the answer comes when it is gone",
                OwnerQuery,
                status=204,
            ),
            Route("GET", nodes, self._list_nodes, "Its nodes", NodesQuery, answer=Page[NodeView]),
            Route(
                "POST",
                nodes,
                self._add_node,
                "Start a node; the answer comes when it runs",
                OwnerQuery,
                NewNode,
                NodeView,
                201,
            ),
            Route("GET", node, self._show_node, "A node", OwnerQuery, answer=NodeView),
            Route(
                "DELETE",
                node,
                self._remove_node,
                "Stop a node; the answer comes when it has ended",
                OwnerQuery,
                status=204,
            ),
            Route(
                "GET", parameters, self._list_parameters, "Its parameters", ParametersQuery, answer=Page[ParameterView]
            ),
            Route("POST", parameters, self._set_parameter, "Set a parameter", OwnerQuery, NewParameter, ParameterView),
            Route("GET", parameter, self._show_parameter, "A parameter", ParameterQuery, answer=ParameterView),
            Route("DELETE", parameter, self._remove_parameter, "Delete a parameter", ParameterQuery, status=204),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(Environments)
        user = authorize_list(call, "environment.read", query.user)

        def keep(each: EnvironmentView) -> bool:
            return (
                rights.may(principal_of(call), "environment.read", each.user, environment=each.containerTag)
                and query.machine in (None, each.machine)
                and query.state in (None, each.state)
                and query.group in ("", each.containerData.group)
            )

        return page_of_records(self._state.environments, user, query, self._master.presenter.environment, keep)

    async def _create(self, call: Call) -> Answer:
        wanted = call.body(NewEnvironment)
        command = m.CreateContainer(wanted.containerTag, wanted.containerData)
        owner = await self._commands.execute(call, call.query(OwnerQuery).user, command)
        environment = self._state.environments.get(f"{owner}/{wanted.containerTag}")
        if environment is None:
            raise NotFound(f"environment {wanted.containerTag} was removed in the meantime", field="environment")
        return created(
            call, owner, self._master.presenter.environment(environment), "environments", wanted.containerTag
        )

    async def _remove(self, call: Call) -> Answer:
        await self._commands.execute(call, call.query(OwnerQuery).user, m.DestroyContainer(call.path["environment"]))
        return Answer(status=204)

    async def _show(self, call: Call) -> Answer:
        return Answer(
            self._master.presenter.environment(
                find_environment(call, self._state, "environment.read", call.query(OwnerQuery).user)
            )
        )

    async def _list_nodes(self, call: Call) -> Answer:
        query, presenter = call.query(NodesQuery), self._master.presenter
        name = find_environment(call, self._state, "node.read", query.user).name
        found = {each.key: presenter.node(each) for each in self._state.nodes.by(name)}
        ended = {each.key: presenter.ended_node(each) for each in self._state.ends.by(name)} if query.all else {}
        return page_of_views((ended | found).items(), query)

    async def _add_node(self, call: Call) -> Answer:
        tag, wanted = call.path["environment"], call.body(NewNode)
        command = m.AddNode(tag, **msgspec.structs.asdict(wanted))
        owner = await self._commands.execute(call, call.query(OwnerQuery).user, command)
        view = self._master.presenter.node(self._find_node(owner, tag, wanted.nodeTag))
        return created(call, owner, view, "environments", tag, "nodes", wanted.nodeTag)

    async def _remove_node(self, call: Call) -> Answer:
        command = m.RemoveNode(call.path["environment"], call.path["node"])
        await self._commands.execute(call, call.query(OwnerQuery).user, command)
        return Answer(status=204)

    async def _show_node(self, call: Call) -> Answer:
        environment = find_environment(call, self._state, "node.read", call.query(OwnerQuery).user)
        end = self._state.ends.get(f"{environment.name}/{call.path['node']}")
        if end is not None and end.key not in self._state.nodes:
            return Answer(self._master.presenter.ended_node(end))
        node = self._find_node(user_of(environment.name), call.path["environment"], call.path["node"])
        return Answer(self._master.presenter.node(node))

    def _find_node(self, owner: str, environment: str, tag: str) -> Node:
        node = self._state.nodes.get(f"{owner}/{environment}/{tag}")
        if node is None:
            known = tags(each.key for each in self._state.nodes.by(f"{owner}/{environment}"))
            raise NotFound(f"in {environment} {unknown('node', tag, known)}", field="node")
        return node

    async def _list_parameters(self, call: Call) -> Answer:
        query = call.query(ParametersQuery)
        environment = find_environment(call, self._state, "parameter.read", query.user)
        records = self._state.parameters.by(environment.name)
        presenter = self._master.presenter.parameter
        return page_of_records(
            records, user_of(environment.name), query, presenter, lambda each: query.node in (None, each.nodeTag)
        )

    async def _set_parameter(self, call: Call) -> Answer:
        tag, wanted = call.path["environment"], call.body(NewParameter)
        command = m.SetParameter(tag, wanted.name, wanted.value, wanted.nodeTag)
        owner = await self._commands.execute(call, call.query(OwnerQuery).user, command)
        return Answer(ParameterView(owner, tag, wanted.nodeTag, wanted.name, wanted.value))

    async def _remove_parameter(self, call: Call) -> Answer:
        query = call.query(ParameterQuery)
        command = m.DeleteParameter(call.path["environment"], call.path["name"], query.node)
        await self._commands.execute(call, query.user, command)
        return Answer(status=204)

    async def _show_parameter(self, call: Call) -> Answer:
        query, name = call.query(ParameterQuery), call.path["name"]
        environment = find_environment(call, self._state, "parameter.read", query.user)
        parameter = self._state.parameters.get(f"{environment.name}/{query.node}:{name}")
        if parameter is None:
            known = [each.name for each in self._state.parameters.by(environment.name)]
            raise NotFound(unknown("parameter", name, known), field="name")
        return Answer(self._master.presenter.parameter(parameter))
