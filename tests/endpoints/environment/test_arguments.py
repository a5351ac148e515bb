"""Command line of a node."""

from pathlib import Path

import pytest

from endpoints.environment.arguments import ros_arguments, split, substitute
from endpoints.environment.packages import Packages
from rce.control.calls.endpoints import NodeSpec
from rce.errors import InvalidName, InvalidRequest, NotFound

PACKAGES = Packages([], [Path(__file__).parent / "packages"])


def test_substitutions() -> None:
    text = substitute("a $(find probe)/b $(env HOME) $HOME", PACKAGES, {"HOME": "/h"})
    assert text == f"a {Path(__file__).parent}/packages/probe/b /h $HOME"


@pytest.mark.parametrize(
    ("text", "error"),
    [("$(find nothing)", NotFound), ("$(env NOTHING)", InvalidRequest), ("$(eval 1)", InvalidRequest)],
)
def test_invalid_substitution_is_rejected(text: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        substitute(text, PACKAGES, {})


def test_length_after_substitution_is_limited() -> None:
    with pytest.raises(InvalidRequest, match="the limit is"):
        substitute("$(env BIG)" * 4, PACKAGES, {"BIG": "x" * 30_000})


def test_package_is_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lookups: list[str] = []
    packages = Packages([], [])

    def share(name: str) -> Path:
        lookups.append(name)
        return Path("/p")

    monkeypatch.setattr(packages, "share", share)
    assert substitute("$(find probe)" * 3, packages, {}) == "/p/p/p"
    assert lookups == ["probe"]


def test_arguments_are_split_without_other_shell_syntax() -> None:
    assert split("a 'b c' \"d\" ; $(x) | > e") == ["a", "b c", "d", ";", "$(x)", "|", ">", "e"]


def test_unbalanced_quote_is_rejected() -> None:
    with pytest.raises(InvalidRequest, match="quotation"):
        split("a 'b")


def test_name_and_namespace_are_remapped() -> None:
    spec = NodeSpec("tag", "p", "e", name="walker", namespace="left/leg")
    arguments = ros_arguments(spec, [], Path("/p.yaml"))
    assert arguments[0] == "--ros-args"
    assert arguments[-6:] == ["--enclave", "/tag", "-r", "__node:=walker", "-r", "__ns:=/left/leg"]


def test_given_enclave_takes_precedence() -> None:
    assert "/tag" not in ros_arguments(NodeSpec("tag", "p", "e"), ["--ros-args", "--enclave", "/mine"], Path("/p"))


@pytest.mark.parametrize("spec", [NodeSpec("t", "p", "e", name="a b"), NodeSpec("t", "p", "e", namespace="a//b")])
def test_invalid_names_are_rejected(spec: NodeSpec) -> None:
    with pytest.raises(InvalidName):
        ros_arguments(spec, [], Path("/p"))
