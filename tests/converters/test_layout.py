"""Layout of messages in CDR."""

from __future__ import annotations

import pytest

from converters.layout import Item, Run, layout
from converters.model import Message, Models
from tests.support.converters.conversions import demo_models

DEFINITIONS = {
    "Mixed": "uint8 a\nfloat64 b\nuint16 c\nstring text\nuint8 d\nuint32 e\n",
    "Outer": "uint8 first\ndemo/Inner inner\nuint8 last\n",
    "Inner": "uint32 x\nuint8 y\n",
    "Empty": "",
}


@pytest.fixture
def models() -> Models:
    return demo_models(**DEFINITIONS)


def steps(message: Message, *, top: bool) -> list[str]:
    """Return the formats of the runs with their alignment, and the paths of the items."""
    return [
        f"{step.mask + 1}:{step.struct.format}" if isinstance(step, Run) else step.path
        for step in layout(message, top=top)
    ]


def test_scalars_are_padded_and_runs_end_at_items(models: Models) -> None:
    assert steps(models.message("demo/msg/Mixed"), top=True) == ["1:<B7xdH", "text", "1:<B", "4:<I"]


def test_run_ends_where_the_padding_is_unknown(models: Models) -> None:
    assert steps(models.message("demo/msg/Mixed"), top=False) == ["1:<B", "8:<dH", "text", "1:<B", "4:<I"]


def test_nested_structs_are_inlined_without_alignment_of_their_own(models: Models) -> None:
    message = models.message("demo/msg/Outer")
    assert steps(message, top=True) == ["1:<B3xIBB"]
    (run,) = layout(message, top=True)
    assert isinstance(run, Run)
    assert [leaf.path for leaf in run.leaves] == ["first", "inner.x", "inner.y", "last"]


def test_empty_struct_is_one_byte(models: Models) -> None:
    (run,) = layout(models.message("demo/msg/Empty"), top=True)
    assert not isinstance(run, Item)
    assert run.struct.size == 1
