"""The catalogue: services that users offer to others, and those that come with RCE.

An offer is looked up by `name` (the user's own, else one that comes with RCE) or by `user/name`. Who may not use an
offer does not see it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from msgspec.structs import replace

from master.graph import secrets
from master.graph.catalogue_records import Offer, OfferedNode, Port
from master.graph.changes import remove_environment
from master.graph.effects import Plan
from master.graph.packages import EVERYBODY, resolve_all
from master.graph.records import ParameterValue, Qos, user_of
from master.graph.state import State
from master.graph.translation import container_data, options_from, qos_message
from master.graph.wiring import Ids
from rce.api import views
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.protocol import messages as m
from rce.protocol.names import check_tag, parse_type
from rce.protocol.variables import check_variables
from rce.spelling import did_you_mean

SHIPPED = "@rce"
"""Publisher of the services that come with RCE; no user's name begins with @."""

MOST_OFFERS = 1000  # of one user
_ADDRESS = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*", re.ASCII)
_KINDS = {"takes": "takes", "gives": "gives", "services": "service", "actions": "action"}


def name_of(offer: Offer) -> str:
    """Return the name of an offer without its publisher."""
    return offer.name.partition("/")[2]


def visible(state: State, user: str) -> list[Offer]:
    """Return the offers that a user may use."""
    terms = (user, SHIPPED, f">{user}", f">{EVERYBODY}")
    return list({each.name: each for term in terms for each in state.offers.by(term)}.values())


def resolve(state: State, user: str, name: str) -> Offer:
    """Return the offer that `name` or `user/name` means.

    Raises:
        NotFound: There is none, or the user may not use it.
    """
    names = [name] if "/" in name else [f"{user}/{name}", f"{SHIPPED}/{name}"]
    found = next((offer for each in names if (offer := state.offers.get(each)) is not None), None)
    if found is None or not {user, EVERYBODY} & {user_of(found.name), *found.shared}:
        known = [each.name.removeprefix(f"{SHIPPED}/").removeprefix(f"{user}/") for each in visible(state, user)]
        hint = did_you_mean(name, known) or "`rce service list` shows which there are"
        raise NotFound(f"there is no service {name[:80]!r} in the catalogue that you may use: {hint}", field="service")
    return found


def own(state: State, user: str, name: str) -> Offer:
    """Return an offer of the user's own.

    Raises:
        NotFound: The user offers no such service.
    """
    offer = state.offers.get(f"{user}/{name}")
    if offer is None:
        raise NotFound(f"you offer no service {name[:80]!r}", field="name")
    return offer


def publish(state: State, user: str, wanted: views.NewOffer, ids: Ids) -> Offer:
    """Put a service into the catalogue, in place of the one that the user offers under this name.

    Instances that run go on as they were, take no more robots, and are stopped when no robot uses them.

    Raises:
        InvalidRequest: The declaration is wrong; the error says where.
        NotFound: The user has no such package.
        LimitExceeded: The user offers too many services.
    """
    offer = offer_of(user, wanted, ids())
    offer = replace(offer, packages=resolve_all(state, user, offer.options.packages))
    if offer.name not in state.offers and state.offers.count(user) >= MOST_OFFERS:
        raise LimitExceeded(f"you offer {MOST_OFFERS} services: remove some", limit=MOST_OFFERS)
    state.offers.put(offer)
    return offer


def offer_of(user: str, wanted: views.NewOffer, revision: str) -> Offer:
    """Return the offer of a declaration, whose packages are not resolved yet.

    Raises:
        InvalidRequest: The declaration is wrong; the error says where.
    """
    check_tag(wanted.name, "name")
    _check_bounds(wanted.robots, wanted.least, wanted.most)
    if wanted.environment.group or wanted.environment.restart != "always":
        raise InvalidRequest("environment: a service has neither a group nor a restart of its own", field="environment")
    if wanted.environment.secrets and wanted.robots == 1:
        raise InvalidRequest(
            "environment.secrets: an instance for one robot belongs to the robot's user, so these would be secrets of "
            "that user; a service with secrets of yours is one with robots of more than 1, whose instances are yours",
            field="environment",
        )
    check_variables(wanted.environment.env | secrets.variables(wanted.environment.secrets))
    ports = list(_ports(wanted))
    names = [port.name for port in ports]
    for kind, all_names in (("name", names), ("nodeTag", [node.nodeTag for node in wanted.nodes])):
        if twice := next((name for name in all_names if all_names.count(name) > 1), None):
            raise InvalidRequest(f"{kind} {twice} is there twice", field=kind)
    _check_values(wanted.parameters, "parameters")
    return Offer(
        name=f"{user}/{wanted.name}",
        revision=revision,
        description=wanted.description,
        ports=ports,
        nodes=[_node(node) for node in wanted.nodes],
        parameters=wanted.parameters,
        options=options_from(wanted.environment),
        packages=[],
        robots=wanted.robots,
        least=wanted.least,
        most=wanted.most,
        most_per_user=wanted.mostPerUser,
        idle=wanted.idle,
        shared=sorted({*wanted.share} - {user}),
    )


def declaration(offer: Offer) -> views.NewOffer:
    """Return the declaration of an offer, as it would be published."""
    ports: dict[str, dict[str, views.OfferedPort | str]] = {name: {} for name in _KINDS}
    for name, kind in _KINDS.items():
        for port in offer.ports:
            if port.kind == kind:
                ports[name][port.name] = views.OfferedPort(port.type, port.address, qos_message(port.qos))
    return views.NewOffer(
        name=name_of(offer),
        description=offer.description,
        **ports,
        nodes=[
            views.OfferedNode(
                *(node.tag, node.package, node.executable, node.arguments, node.name, node.namespace),
                *(node.restart, node.per_robot, node.parameters),
            )
            for node in offer.nodes
        ],
        parameters=offer.parameters,
        environment=container_data(offer.options),
        robots=offer.robots,
        least=offer.least,
        most=offer.most,
        mostPerUser=offer.most_per_user,
        idle=offer.idle,
        share=offer.shared,
    )


def scale(state: State, offer: Offer, least: int, most: int) -> Offer:
    """Change the bounds for the number of shared instances.

    Raises:
        InvalidRequest: The bounds are wrong, or instances are not shared.
    """
    if not offer.is_shared:
        raise InvalidRequest(f"{name_of(offer)} is not shared: each robot has an instance of its own", field="least")
    _check_bounds(offer.robots, least, most)
    offer = replace(offer, least=least, most=most)
    state.offers.put(offer)
    return offer


def remove(state: State, offer: Offer) -> Plan:
    """Remove an offer and its shared instances. Those of single robots stay until they are idle."""
    plan: Plan = []
    for instance in state.instances.by(offer.name):
        environment = state.environments.get(instance.environment)
        if environment is not None and offer.is_shared:
            plan += remove_environment(state, environment)
    for tally in state.tallies.by(offer.name):
        state.tallies.drop(tally.key)
    state.offers.drop(offer.name)
    return plan


def user_gone(state: State, user: str) -> Plan:
    """Remove all that the catalogue has of a user: a later user of the name must not inherit it."""
    plan: Plan = []
    for offer in state.offers.by(user):
        plan += remove(state, offer)
    for tally in state.tallies.by(user):
        state.tallies.drop(tally.key)
    for offer in state.offers.by(f">{user}"):
        state.offers.put(replace(offer, shared=[each for each in offer.shared if each != user]))
    return plan


def drop_strays(state: State, users: set[str]) -> None:
    """Remove the offers of removed users, and their shares."""
    for offer in state.offers:
        shared = [user for user in offer.shared if user in {*users, EVERYBODY}]
        if user_of(offer.name) not in users:
            state.offers.drop(offer.name)
        elif shared != offer.shared:
            state.offers.put(replace(offer, shared=shared))


def _check_bounds(robots: int, least: int, most: int) -> None:
    if robots == 1 and (least, most) != (0, 1):
        raise InvalidRequest("least and most are for services with robots of more than 1, whose instances are shared")
    if least > most:
        raise InvalidRequest(f"least {least} is more than most {most}", field="least")


def _ports(wanted: views.NewOffer) -> Iterable[Port]:
    for group, kind in _KINDS.items():
        for name, given in getattr(wanted, group).items():
            port = views.OfferedPort(given) if isinstance(given, str) else given
            where = f"{group}.{name}"
            check_tag(name, where)
            parse_type(port.type)
            address = port.address or name
            if not _ADDRESS.fullmatch(address):
                raise InvalidRequest(f"{where}: {address[:80]!r} is not the name of a topic or service", field=where)
            qos = Qos(port.qos.reliability, port.qos.durability, port.qos.history, port.qos.depth)
            yield Port(name, kind, port.type, address, qos)  # type: ignore[arg-type]


def _node(node: views.OfferedNode) -> OfferedNode:
    check_tag(node.nodeTag, "nodeTag")
    _check_values(node.parameters, f"nodes.{node.nodeTag}.parameters")
    return OfferedNode(
        *(node.nodeTag, node.pkg, node.exe, node.args, node.name, node.namespace),
        *(node.restart, node.perRobot, node.parameters),
    )


def _check_values(parameters: dict[str, ParameterValue], where: str) -> None:
    for name, value in parameters.items():
        try:
            m.SetParameter("", name, value)
        except InvalidRequest as error:
            raise InvalidRequest(f"{where}.{name}: {error}", field=where) from None
