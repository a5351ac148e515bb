"""The command line of a node."""

from pathlib import Path

import pytest

from endpoints.environment.arguments import ros_arguments, split, substitute
from endpoints.environment.packages import Packages
from rce.calls.endpoints import NodeSpec
from rce.errors import InvalidName, InvalidRequest, NotFound

PACKAGES = Packages([], [Path(__file__).parent / "packages"])


def test_substitutions() -> None:
    text = substitute("a $(find probe)/b $(env HOME) $HOME", PACKAGES, {"HOME": "/h"})
    assert text == f"a {Path(__file__).parent}/packages/probe/b /h $HOME"


@pytest.mark.parametrize(
    ("text", "error"),
    [("$(find nothing)", NotFound), ("$(env NOTHING)", InvalidRequest), ("$(eval 1)", InvalidRequest)],
)
def test_what_cannot_be_substituted_is_said(text: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        substitute(text, PACKAGES, {})


def test_what_becomes_too_long() -> None:
    with pytest.raises(InvalidRequest, match="at most"):
        substitute("$(env BIG)" * 4, PACKAGES, {"BIG": "x" * 30_000})


def test_a_package_is_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    packages = Packages([], [])

    def share(name: str) -> Path:
        asked.append(name)
        return Path("/p")

    monkeypatch.setattr(packages, "share", share)
    assert substitute("$(find probe)" * 3, packages, {}) == "/p/p/p"
    assert asked == ["probe"]


def test_split_as_a_shell_but_without_one() -> None:
    assert split("a 'b c' \"d\" ; $(x) | > e") == ["a", "b c", "d", ";", "$(x)", "|", ">", "e"]


def test_open_quote() -> None:
    with pytest.raises(InvalidRequest, match="quotation"):
        split("a 'b")


def test_name_and_namespace_are_remapped() -> None:
    spec = NodeSpec("tag", "p", "e", name="walker", namespace="left/leg")
    arguments = ros_arguments(spec, [], Path("/p.yaml"))
    assert arguments[0] == "--ros-args"
    assert arguments[-6:] == ["--enclave", "/tag", "-r", "__node:=walker", "-r", "__ns:=/left/leg"]


def test_own_ros_arguments_win() -> None:
    assert "/tag" not in ros_arguments(NodeSpec("tag", "p", "e"), ["--ros-args", "--enclave", "/mine"], Path("/p"))


@pytest.mark.parametrize("spec", [NodeSpec("t", "p", "e", name="a b"), NodeSpec("t", "p", "e", namespace="a//b")])
def test_illegal_names(spec: NodeSpec) -> None:
    with pytest.raises(InvalidName):
        ros_arguments(spec, [], Path("/p"))
