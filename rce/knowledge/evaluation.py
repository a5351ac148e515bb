"""Evaluation of SPARQL queries with pyoxigraph, in a process of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import pyoxigraph
from pyparsing import ParseBaseException
from rdflib.plugins.sparql.parser import parseQuery
from rdflib.plugins.sparql.parserutils import CompValue

from rce.api.knowledge import QueryResult
from rce.errors import InvalidRequest, LimitExceeded

MAX_ANSWER = 8 * 1024 * 1024  # characters


def check_query(query: str) -> None:
    """Check a query before it is evaluated.

    Raises:
        InvalidRequest: It is malformed, an update such as LOAD, or asks other servers (SERVICE).
    """
    try:
        parsed = parseQuery(query)
    except ParseBaseException as error:
        reason = (
            f"line {error.lineno}, column {error.column}: not a SPARQL query at {error.line[error.column - 1 :][:60]!r}"
        )
        hint = "; updates, such as LOAD, are not allowed" if _is_update(query) else ""
        raise InvalidRequest(reason + hint, field="query") from None
    except RecursionError:
        raise InvalidRequest("the query is nested too deeply", field="query") from None
    if any(part.name == "ServiceGraphPattern" for part in _parts(parsed)):
        raise InvalidRequest("SERVICE is not allowed: queries see this repository only", field="query")


def _is_update(query: str) -> bool:
    words = ("LOAD", "INSERT", "DELETE", "CLEAR", "DROP", "CREATE", "COPY", "MOVE", "ADD")
    return any(word in query.upper().split() for word in words)


def _parts(value: Any) -> Iterator[CompValue]:
    """Yield all parts of a parsed query."""
    waiting = [value]
    while waiting:
        each = waiting.pop()
        if isinstance(each, CompValue):
            yield each
            waiting.extend(each.values())
        elif isinstance(each, Iterable) and not isinstance(each, str):
            waiting.extend(each)


def evaluate(store: pyoxigraph.Store, query: str, rows: int) -> QueryResult:
    """Answer a query.

    Raises:
        InvalidRequest: The query is refused.
        LimitExceeded: The answer has more than `rows` rows, or too much text.
    """
    check_query(query)
    try:
        found = store.query(query)
        if isinstance(found, pyoxigraph.QueryBoolean):
            return QueryResult(answer=bool(found))
        if isinstance(found, pyoxigraph.QuerySolutions):
            names = [variable.value for variable in found.variables]
            return QueryResult(names, _rows(([*solution] for solution in found), rows))
        return QueryResult(["subject", "predicate", "object"], _rows(([*triple] for triple in found), rows))
    except (SyntaxError, ValueError, RuntimeError, OSError) as error:
        raise InvalidRequest(f"the query is refused: {error}", field="query") from None


def _rows(found: Iterable[list[Any]], limit: int) -> list[list[str | None]]:
    rows: list[list[str | None]] = []
    size = 0
    for values in found:
        row = [None if value is None else str(value) for value in values]
        size += sum(len(value or "") for value in row)
        if len(rows) == limit or size > MAX_ANSWER:
            raise LimitExceeded(
                f"the answer has more than {limit} rows or {MAX_ANSWER} characters: add LIMIT and OFFSET", field="query"
            )
        rows.append(row)
    return rows
