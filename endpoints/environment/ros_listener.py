"""Listeners of ROS entities, which run in the asyncio loop.

A listener of DDS is called in a thread of DDS. If it were a Python function, that thread would have to wait for the GIL
while the loop is busy. So the listener is `eventfd_write` of the C library, whose arguments are those that ROS passes:
the descriptor in the place of the user data, and the number of messages. The loop reads the descriptor.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from twisted.logger import Logger

log = Logger()
Action = Callable[[], None]

if TYPE_CHECKING:  # these classes are generic for type checkers only
    Entity = _rclpy.Subscription[Any] | _rclpy.Client[Any, Any] | _rclpy.Service[Any, Any] | _rclpy.EventHandle[Any]

_rcl = ctypes.CDLL("librcl.so")  # loaded by rclpy
_EVENTFD_WRITE = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
_ATTACH: dict[type[Any], Any] = {
    _rclpy.Subscription: _rcl.rcl_subscription_set_on_new_message_callback,
    _rclpy.Client: _rcl.rcl_client_set_on_new_response_callback,
    _rclpy.Service: _rcl.rcl_service_set_on_new_request_callback,
    _rclpy.EventHandle: _rcl.rcl_event_set_callback,
}
for _function in _ATTACH.values():
    _function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]


def attempt(action: Action) -> None:
    """Run an action; log its error, so that it does not stop others."""
    try:
        action()
    except Exception:  # noqa: BLE001  # whatever it is
        log.failure("defect in an action for ROS")


class Listener:
    """Runs an action in the loop when entities have got messages, or events, since it was run the last time.

    All methods do nothing once it is closed.

    Args:
        loop: The asyncio loop.
        action: What to run. What it leaves in the entities does not run it again; see `again`.
        entities: The entities, which have had no other listener. What they have already runs the action too.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, action: Action, entities: Sequence[Entity]) -> None:
        self._loop = loop
        self._action = action
        self._entities = entities
        self._closed = False
        self._descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self.resume()
        for entity in entities:
            self._set(entity, _EVENTFD_WRITE)

    def pause(self) -> None:
        """Do not run the action until `resume`."""
        if not self._closed:
            self._loop.remove_reader(self._descriptor)

    def resume(self) -> None:
        """Run the action for what has come since `pause`, and from now on."""
        if not self._closed:
            self._loop.add_reader(self._descriptor, self.run)

    def run(self) -> None:
        """Run the action now, if something has come."""
        if self._closed:
            return
        try:
            os.eventfd_read(self._descriptor)
        except BlockingIOError:
            return
        attempt(self._action)

    def again(self) -> None:
        """Run the action once more, after others have had their turn."""
        if not self._closed:
            os.eventfd_write(self._descriptor, 1)

    def close(self) -> None:
        """End; must be called before the entities are destroyed."""
        if self._closed:
            return
        for entity in self._entities:
            self._set(entity, None)
        self._entities = ()
        self.pause()
        self._closed = True
        os.close(self._descriptor)

    def _set(self, entity: Entity, listener: ctypes.c_void_p | None) -> None:
        failed = _ATTACH[type(entity)](entity.pointer, listener, self._descriptor)
        if failed:
            raise RuntimeError(f"ROS does not take a listener of a {type(entity).__name__} (error {failed})")
