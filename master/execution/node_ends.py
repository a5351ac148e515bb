"""Nodes that end by themselves: their users are told, the end is kept, and some are started again after a pause."""

from __future__ import annotations

import time
from collections.abc import Callable

from msgspec.structs import replace

from master.execution.backoff import Backoff
from master.execution.effect_runner import EffectRunner, raise_first_error
from master.graph.changes import call_host, drop_launched, launched_by
from master.graph.effects import Plan
from master.graph.records import Environment, Node, NodeEnd, Process, ref, user_of
from master.graph.translation import launched_node, node_spec
from rce.control.calls.call import Nothing
from rce.control.calls.endpoints import Launched, NodeDied, StartNode
from rce.errors import RceError
from rce.protocol.messages import NodeEvent

STEADY = 5.0  # seconds; a node that ran this long before it failed did start, so it is started again
PAUSE = 0.1  # seconds before the first restart
PAUSE_FIRST, PAUSE_MOST, PAUSE_RESET = 0.5, 30.0, 60.0  # seconds; see Backoff
KEPT_LINES, KEPT_LENGTH = 10, 400  # of the output of an ended node
KEPT_ENDS = 50  # of an environment


class NodeEnds:
    """Acts on the ends of nodes; `apply` saves what changed and runs a plan."""

    def __init__(self, runner: EffectRunner, apply: Callable[[Plan], None]) -> None:
        self._runner = runner
        self._state = runner.state
        self._apply = apply
        self._waiting: dict[str, Node] = {}  # nodes that ended, by key, until they are started again
        self._backoff = Backoff(PAUSE_FIRST, PAUSE_MOST, PAUSE_RESET)

    async def node_died(self, process: Process, call: NodeDied) -> Nothing:
        """Handle the report of an Environment endpoint."""
        node = self._state.nodes.get(f"{process.name}/{call.node}")
        environment = self._state.environments.get(process.name)
        if node is None or environment is None or self._waiting.get(node.key) is node:
            return Nothing()
        if process.incarnation != environment.run:
            return Nothing()  # a report of an earlier life: the next one has its own node of this tag
        tag = process.name.partition("/")[2]
        self._runner.tell(user_of(process.name), NodeEvent(tag, call.node, call.status, call.lines))
        self._keep(node, call.status, call.lines)
        drop_launched(self._state, node)
        if node.part_of and call.again:
            self._runner.readiness.forget(ref(node))
        elif is_restarted(node, environment, call):
            self._waiting[node.key] = node
            self._runner.readiness.forget(ref(node))
            pause = max(PAUSE, self._backoff.after_failure(node.key))
            self._runner.later(pause, lambda: self._restart(node))
        else:
            self._state.nodes.drop(node.key)  # its tag is free
        self._apply([])
        return Nothing()

    async def launched(self, process: Process, call: Launched) -> Nothing:
        """Note the nodes that run of a launch."""
        launch = self._state.nodes.get(f"{process.name}/{call.node}")
        environment = self._state.environments.get(process.name)
        if launch is None or environment is None or process.incarnation != environment.run:
            return Nothing()
        running = [launched_node(launch, spec) for spec in call.nodes]
        kept = {node.key for node in running}
        for node in launched_by(self._state, launch):
            if node.key not in kept and node.key not in self._state.ends:  # one that ended may start again
                self._state.nodes.drop(node.key)
        for node in running:
            self._state.nodes.put(node)
            self._runner.readiness.mark_ready(ref(node))
        self._apply([])
        return Nothing()

    def _keep(self, node: Node, status: int, lines: list[str]) -> None:
        before = self._state.ends.get(node.key)
        kept = [line[:KEPT_LENGTH] for line in lines[-KEPT_LINES:]]
        self._state.ends.put(NodeEnd(node, status, kept, time.time(), before.count + 1 if before else 1))
        ended = [end for end in self._state.ends.by(node.owner) if end.key not in self._state.nodes]
        for end in sorted(ended, key=lambda end: end.time)[:-KEPT_ENDS]:
            self._state.ends.drop(end.key)

    async def _restart(self, node: Node) -> None:
        if self._waiting.get(node.key) is not node:
            return  # another node of its tag ended meanwhile
        del self._waiting[node.key]
        if self._state.nodes.get(node.key) != node:
            return  # it was removed or replaced
        try:
            raise_first_error(await self._runner.run(call_host(self._state, node, StartNode(node_spec(node)))))
        except RceError as error:
            if self._state.nodes.get(node.key) == node:
                self._state.nodes.drop(node.key)
                end = self._state.ends.get(node.key)
                if end is not None:
                    self._state.ends.put(
                        replace(end, lines=[*end.lines, f"not started again: {str(error)[:KEPT_LENGTH]}"])
                    )
                self._apply([])
            self._runner.tell(user_of(node.owner), error=error.info)


def is_restarted(node: Node, environment: Environment, call: NodeDied) -> bool:
    """Return whether a node that ended is started again.

    Unless the node says when, it is if it failed after it had run for a while.
    """
    if node.part_of:
        return False
    match node.restart:
        case "always":
            return True
        case "no":
            return False
        case "on-failure":
            return call.status != 0
    return call.status != 0 and environment.options.restart == "always" and call.seconds >= STEADY
