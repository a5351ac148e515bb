"""Places for requests at a server."""

from __future__ import annotations

from endpoints.environment.service_slots import MAX_IN_FLIGHT, ServiceSlots, Slots


class Caller:
    """Caller that wants some places."""

    def __init__(self, slots: Slots, wanted: int) -> None:
        self._slots = slots
        self.wanted = wanted
        self.taken = 0

    def resume(self) -> None:
        while self.wanted and self._slots.take(self.resume):
            self.wanted -= 1
            self.taken += 1


def test_callers_take_turns() -> None:
    slots = Slots()
    callers = [Caller(slots, MAX_IN_FLIGHT + 2) for _ in range(3)]
    for caller in callers:
        caller.resume()
    assert [caller.taken for caller in callers] == [MAX_IN_FLIGHT, 0, 0]
    for _ in range(5):
        slots.give_back()
    assert [caller.taken for caller in callers] == [MAX_IN_FLIGHT + 2, 2, 1]


def test_place_goes_to_the_next_if_a_caller_wants_none_any_more() -> None:
    slots = Slots()
    callers = [Caller(slots, MAX_IN_FLIGHT), *(Caller(slots, 1) for _ in range(3))]
    for caller in callers:
        caller.resume()
    callers[1].wanted = 0
    slots.leave(callers[2].resume)
    slots.give_back()
    assert [caller.taken for caller in callers] == [MAX_IN_FLIGHT, 0, 0, 1]


def test_names_of_one_service_are_the_same() -> None:
    slots = ServiceSlots()
    assert slots.of("plan") is (kept := slots.of("/plan"))
    assert slots.of("/other") is not kept
