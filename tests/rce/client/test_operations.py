"""Commands of a robot: what each method sends, and which errors it raises."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest

from rce.client.declarations import Declarations
from rce.client.operations import Operations
from rce.client.session import ClientSession
from rce.errors import AlreadyExists, InvalidRequest, NotFound, RceError
from rce.protocol import messages as m

STRING = "std_msgs/String"


class FakeSession:
    """Session that records commands and answers them with the errors in `errors`, by the type of the command."""

    def __init__(self) -> None:
        self.commands: list[m.Command] = []
        self.errors: dict[type[m.Command], RceError] = {}

    async def execute(self, command: m.Command) -> None:
        self.commands.append(command)
        if type(command) in self.errors:
            raise self.errors[type(command)]


@pytest.fixture
def session() -> FakeSession:
    return FakeSession()


@pytest.fixture
def declarations() -> Declarations:
    return Declarations("a")


@pytest.fixture
def operations(session: FakeSession, declarations: Declarations) -> Operations:
    return Operations(cast(ClientSession, session), declarations)


@pytest.mark.parametrize(
    ("call", "command"),
    [
        (lambda a: a.create_environment("brain"), m.CreateContainer("brain")),
        (lambda a: a.destroy_environment("brain"), m.DestroyContainer("brain")),
        (
            lambda a: a.add_node("brain", "echo", "Test", "echo.py", args="-v", name="n", namespace="/s"),
            m.AddNode("brain", "echo", "Test", "echo.py", "-v", "n", "/s"),
        ),
        (lambda a: a.remove_node("brain", "echo"), m.RemoveNode("brain", "echo")),
        (
            lambda a: a.set_parameter("brain", "rate", [1, 2], node="echo"),
            m.SetParameter("brain", "rate", [1, 2], "echo"),
        ),
        (lambda a: a.delete_parameter("brain", "rate", node="echo"), m.DeleteParameter("brain", "rate", "echo")),
        (
            lambda a: a.add_recorder("brain", "box", "/a", max_size=5, max_duration=2.0, exist_ok=True),
            m.AddRecorder("brain", "box", ["/a"], 5, 2.0, True),
        ),
        (lambda a: a.remove_recorder("brain", "box"), m.RemoveRecorder("brain", "box")),
        (
            lambda a: a.add_interface("brain", "in", "PublisherInterface", STRING, addr="/in", qos=m.Qos(depth=3)),
            m.AddInterface("brain", "in", "PublisherInterface", STRING, "/in", m.Qos(depth=3)),
        ),
        (
            lambda a: a.add_interface("a", "in", "PublisherConverter", STRING, format="jpeg"),
            m.AddInterface("a", "in", "PublisherConverter", STRING, format="jpeg"),
        ),
        (lambda a: a.remove_interface("brain", "in"), m.RemoveInterface("brain", "in")),
        (lambda a: a.connect("a/out", "brain/in"), m.Connect("a/out", "brain/in")),
        (lambda a: a.disconnect("a/out", "brain/in"), m.Disconnect("a/out", "brain/in")),
    ],
)
async def test_method_sends_its_command(
    operations: Operations,
    session: FakeSession,
    call: Callable[[Operations], Awaitable[None]],
    command: m.Command,
) -> None:
    await call(operations)
    assert session.commands == [command]


async def test_options_of_an_environment_have_python_names(operations: Operations, session: FakeSession) -> None:
    await operations.create_environment(
        "brain", size=2, group_ip="192.168.1.7", special_features=["arm"], io=m.Rates(read=5), restart="no"
    )
    data = m.ContainerData(size=2, groupIP="192.168.1.7", specialFeatures=["arm"], io=m.Rates(read=5), restart="no")
    assert session.commands == [m.CreateContainer("brain", data)]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"size": 0}, "size"),
        ({"cpu": "many"}, "cpu"),
        ({"restart": "maybe"}, "restart"),
        ({"env": {"1X": "y"}}, "env"),
        ({"memroy": 5}, "memroy"),
        ({"groupIP": "192.168.1.7"}, "groupIP"),
    ],
)
async def test_wrong_option_of_an_environment_is_refused_before_it_is_sent(
    operations: Operations, session: FakeSession, options: dict[str, Any], reason: str
) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        await operations.create_environment("brain", **options)
    assert session.commands == []


async def test_existing_environment_is_accepted_on_request(operations: Operations, session: FakeSession) -> None:
    session.errors[m.CreateContainer] = AlreadyExists("brain exists")
    with pytest.raises(AlreadyExists):
        await operations.create_environment("brain")
    await operations.create_environment("brain", exist_ok=True)
    session.errors[m.CreateContainer] = InvalidRequest("no such image")
    with pytest.raises(InvalidRequest):
        await operations.create_environment("brain", exist_ok=True)


async def test_failed_command_does_not_stop_the_others(
    operations: Operations, session: FakeSession, declarations: Declarations
) -> None:
    session.errors = {m.Connect: NotFound("no interface"), m.RemoveNode: NotFound("no node")}
    added = m.AddInterface("a", "out", "SubscriberConverter", STRING)
    with pytest.raises(NotFound, match="no interface") as caught:
        await operations.configure(m.DestroyContainer("brain"), m.Connect("a/x", "b/y"), m.RemoveNode("b", "n"), added)
    assert caught.value.item == "commands[1]"
    assert len(session.commands) == 4
    assert declarations.commands() == [added], "only commands that were executed are declared again"


async def test_error_of_a_single_command_names_no_item(operations: Operations, session: FakeSession) -> None:
    session.errors[m.Connect] = NotFound("no interface")
    with pytest.raises(NotFound) as caught:
        await operations.connect("a/x", "b/y")
    assert caught.value.item == ""


async def test_no_commands_are_no_error(operations: Operations, session: FakeSession) -> None:
    await operations.configure()
    assert session.commands == []
