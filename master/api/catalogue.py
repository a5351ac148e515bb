"""`/api/v1/catalogue`: services that users offer to others, their instances, and their use."""

from __future__ import annotations

from master.api.commands import Commands
from master.api.principals import authorize, page_of_views
from master.api.request import Answer, Call, OwnerQuery, PageQuery
from master.api.router import Api, Route
from master.execution.effect_runner import new_id
from master.graph import catalogue
from master.graph.catalogue_records import Instance, Offer
from master.graph.records import user_of
from master.service import Master
from rce.api.views import EnvironmentView, InstanceView, NewOffer, NewUse, OfferView, Page, Scale
from rce.errors import NotFound
from rce.protocol import messages as m

AT = "/catalogue/{publisher}/{name}"


class CatalogueApi:
    """Routes of the catalogue."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._commands = Commands(master)

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        uses = AT + "/uses"
        api.add(
            Route("GET", "/catalogue", self._list, "Services that you may use", PageQuery, answer=Page[OfferView]),
            Route("POST", "/catalogue", self._publish, "Publish a service", None, NewOffer, OfferView, 201),
            Route("GET", AT, self._show, "A service of the catalogue", answer=OfferView),
            Route("PATCH", AT, self._scale, "Change the bounds of its shared instances", body=Scale, answer=OfferView),
            Route("DELETE", AT, self._remove, "Remove a service with its shared instances", status=204),
            Route(
                "POST",
                uses,
                self._use,
                "Let a robot use a service, or start an instance of your own; the answer comes when it is ready",
                OwnerQuery,
                NewUse,
                OfferView,
                201,
            ),
        )

    async def _list(self, call: Call) -> Answer:
        user = authorize(call, "catalogue.read", "")
        seen = catalogue.visible(self._state, user)
        return page_of_views(((each.key, self._view(each, user)) for each in seen), call.query(PageQuery))

    async def _publish(self, call: Call) -> Answer:
        user = authorize(call, "catalogue.publish", "")
        wanted = call.body(NewOffer)
        known = {*await self._master.users.names(), "*"}
        if unknown := sorted(set(wanted.share) - known):
            raise NotFound(f"there is no user {unknown[0][:80]!r}", field="share")
        offer = catalogue.publish(self._state, user, wanted, new_id)
        return await self._saved(offer, user, 201)

    async def _show(self, call: Call) -> Answer:
        user = authorize(call, "catalogue.read", "")
        return Answer(self._view(self._find(call, user), user))

    async def _scale(self, call: Call) -> Answer:
        offer = self._own(call)
        bounds = call.body(Scale)
        offer = catalogue.scale(self._state, offer, bounds.least, bounds.most)
        self._master.instance_keeper.check()
        return await self._saved(offer, user_of(offer.name))

    async def _remove(self, call: Call) -> Answer:
        await self._master.apply(catalogue.remove(self._state, self._own(call)))
        return Answer(status=204)

    async def _use(self, call: Call) -> Answer:
        wanted = call.body(NewUse)
        owner = authorize(call, "service.use", call.query(OwnerQuery).user, robot=wanted.robot)
        offer = self._find(call, owner)
        command = m.UseService(offer.name, wanted.containerTag or catalogue.name_of(offer))
        await self._commands.execute(call, owner, command, wanted.robot)
        return Answer(self._view(offer, owner), 201)

    async def _saved(self, offer: Offer, user: str, status: int = 200) -> Answer:
        await self._master.save()
        return Answer(self._view(offer, user), status)

    def _find(self, call: Call, user: str) -> Offer:
        return catalogue.resolve(self._state, user, f"{call.path['publisher']}/{call.path['name']}")

    def _own(self, call: Call) -> Offer:
        user = authorize(call, "catalogue.publish", call.path["publisher"])
        return catalogue.own(self._state, user, call.path["name"])

    def _view(self, offer: Offer, user: str) -> OfferView:
        """Return what a user may see of an offer."""
        publisher = user_of(offer.name)
        declared = catalogue.declaration(offer)
        seen = [each for each in self._state.instances.by(offer.name) if user in (publisher, user_of(each.environment))]
        instances = [view for each in seen if (view := self._instance(each, offer)) is not None]
        tallies = self._state.tallies.by(offer.name)
        uses = {tally.user: tally.uses for tally in tallies if user in (publisher, tally.user)}
        if user != publisher:
            declared = NewOffer(**{name: getattr(declared, name) for name in _PUBLIC})
        return OfferView(publisher, declared, instances, uses)

    def _instance(self, instance: Instance, offer: Offer) -> InstanceView | None:
        environment = self._state.environments.get(instance.environment)
        if environment is None:
            return None
        view: EnvironmentView = self._master.presenter.environment(environment)
        robots = sorted(use.robot for use in self._state.uses.by(environment.name))
        return InstanceView(view.user, view.containerTag, view.state, robots, instance.revision == offer.revision)


_PUBLIC = (
    "name",
    "description",
    "takes",
    "gives",
    "services",
    "actions",
    "robots",
    "least",
    "most",
    "mostPerUser",
    "idle",
)
"""Fields of a declaration that all who may use a service see: neither its programs nor who else may use it."""
