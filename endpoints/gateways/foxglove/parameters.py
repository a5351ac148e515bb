"""Parameters of the nodes for a client, as `NODE.NAME`: read, set, and their changes by /parameter_events.

A client that leaves out the leading slash gets the names as it has written them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import msgspec

from endpoints.gateways.asker import Asker
from endpoints.gateways.foxglove import messages
from endpoints.gateways.guest import Guest
from endpoints.gateways.parameters import Parameters, value_of
from endpoints.gateways.uses import SUBSCRIBE, Arrived, Frame, Use
from rce.errors import InvalidRequest, LimitExceeded, RceError

EVENTS, EVENT = "/parameter_events", "rcl_interfaces/ParameterEvent"
MAX_WANTED = 10_000  # parameters whose changes one client gets
MAX_NAME = 1000  # characters
Report = Callable[[RceError], None]


class ClientParameters:
    """Parameters for one client."""

    def __init__(self, guest: Guest, report: Report) -> None:
        self._guest = guest
        self._report = report
        self._parameters = Parameters(guest.view.present_graph, Asker(guest))
        self._wanted: dict[str, str] = {}  # names as the client writes them, by those of the nodes
        self._events: Use | None = None

    async def get(self, names: Collection[str], id: str | None) -> None:
        """Send the values of these parameters, or of all."""
        await self._guest.changes.settle()
        asked = {_inner(name): name for name in names}
        try:
            found = await self._parameters.values(asked)
        except RceError as error:
            self._report(error)
            return
        self._send({asked.get(name) or _outer(name): value for name, value in found.items()}.items(), id)

    async def set(self, wanted: Sequence[messages.Parameter], id: str | None) -> None:
        """Set parameters one after the other; with an id send their values then."""
        async with self._guest.changes.carry_out():  # after a subscription to the changes that are made here
            for each in wanted:
                await self._set(each)
        if id is not None:
            await self.get([each.name for each in wanted], id)

    async def _set(self, wanted: messages.Parameter) -> None:
        try:
            value = float(wanted.value) if wanted.type == "float64" else wanted.value
            await self._parameters.set(_inner(wanted.name), value)
        except RceError as error:
            self._report(error)
        except (TypeError, ValueError, OverflowError):
            self._report(InvalidRequest(f"parameter {wanted.name[:200]}: {wanted.value!r:.80} is not a number"))

    def subscribe(self, names: Collection[str]) -> None:
        """Send the changes of these parameters from now on.

        Raises:
            LimitExceeded: The client asked for too many, or too many operations are in progress.
        """
        wanted = self._wanted | {_inner(name): name for name in names}
        if len(wanted) > MAX_WANTED or any(len(name) > MAX_NAME for name in names):
            raise LimitExceeded(f"subscribe to {MAX_WANTED} parameters at most, with names of {MAX_NAME} characters")
        if wanted and self._events is None:
            self._events = use = self._guest.use(
                SUBSCRIBE, EVENTS, EVENT, self._changed, lambda _, error: self._report(error)
            )
            use.on_end(lambda error: self._ended(use, error))
        self._wanted = wanted

    def _ended(self, use: Use, error: RceError) -> None:
        if self._events is use:  # else the client has given it up
            self._events = None
            self._report(error)

    def unsubscribe(self, names: Iterable[str]) -> None:
        """Send the changes of these parameters no more."""
        for name in names:
            self._wanted.pop(_inner(name), None)
        if not self._wanted and self._events is not None:
            self._guest.drop(self._events)
            self._events = None

    def _changed(self, arrived: Arrived) -> Sequence[Frame]:
        event = msgspec.json.decode(arrived.value[:-1])
        node = event["node"]
        changed = {
            f"{node}:{each['name']}": value_of(each["value"])
            for each in (*event["new_parameters"], *event["changed_parameters"])
        }
        changed |= {f"{node}:{each['name']}": None for each in event["deleted_parameters"]}
        shown = [(self._wanted[name], value) for name, value in changed.items() if name in self._wanted]
        return (_values(shown, None),) if shown else ()

    def _send(self, values: Iterable[tuple[str, Any]], id: str | None) -> None:
        self._guest.send(_values(values, id))


def _values(values: Iterable[tuple[str, Any]], id: str | None) -> bytes:
    fields: dict[str, object] = {"op": "parameterValues", "parameters": [_record(*pair) for pair in values]}
    return messages.text(**fields if id is None else fields | {"id": id})


def _record(name: str, value: Any) -> dict[str, object]:
    if value is None:
        return {"name": name}
    record: dict[str, object] = {"name": name, "value": value}
    if isinstance(value, float):
        record["type"] = "float64"
    elif isinstance(value, list) and value and isinstance(value[0], float):
        record["type"] = "float64_array"
    return record


def _inner(name: str) -> str:
    """Return a name as `/NODE:NAME`."""
    node, _, parameter = name.partition(".")
    return f"/{node.lstrip('/')}:{parameter}"


def _outer(name: str) -> str:
    return name.replace(":", ".", 1)
