"""Check of XML before it is parsed as RDF: well-formed, bounded, and without anything from elsewhere.

Entities with a text are allowed, since OWL files abbreviate namespaces with them. Entities and DTDs from elsewhere are
not, nor entities within entities, whose expansion is not bounded by the size of the file.
"""

from __future__ import annotations

from xml.parsers import expat

from rce.errors import InvalidRequest

MAX_DEPTH = 200
MAX_ELEMENTS = 200_000
MAX_ENTITIES = 200
MAX_EXPANSION = 16 * 1024 * 1024  # characters that the references of a text may expand to


def check_markup(text: str) -> None:
    """Check an XML text.

    Raises:
        InvalidRequest: It is refused; the message has line, column and reason.
    """
    _Checker(text).check()


class _Checker:
    def __init__(self, text: str) -> None:
        self._text = text
        self._references = text.count("&")
        self._entities = self._elements = self._depth = self._longest = 0
        self._parser = parser = expat.ParserCreate("utf-8", " ")
        parser.StartDoctypeDeclHandler = self._doctype
        parser.EntityDeclHandler = self._entity
        parser.AttlistDeclHandler = parser.ElementDeclHandler = parser.NotationDeclHandler = self._declaration
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end

    def check(self) -> None:
        try:
            self._parser.Parse(self._text.encode("utf-8", "replace"), True)
        except expat.ExpatError as error:
            reason = expat.errors.messages.get(error.code, "malformed")
            raise _refused(error.lineno, error.offset, reason) from None

    def _refuse(self, reason: str) -> InvalidRequest:
        return _refused(self._parser.CurrentLineNumber, self._parser.CurrentColumnNumber, reason)

    def _doctype(self, name: str, system: str | None, public: str | None, internal: int) -> None:
        if system or public:
            raise self._refuse("a DTD from elsewhere is not allowed")

    def _entity(
        self, name: str, parameter: int, value: str | None, base: str | None, system: str | None, *more: str | None
    ) -> None:
        if parameter:
            raise self._refuse(f"the parameter entity {name} is not allowed")
        if value is None:
            raise self._refuse(f"the entity {name} from elsewhere is not allowed")
        if "&" in value:
            raise self._refuse(f"the entity {name} refers to another one, which is not allowed")
        self._entities += 1
        self._longest = max(self._longest, len(value))
        if self._entities > MAX_ENTITIES:
            raise self._refuse(f"there are more than {MAX_ENTITIES} entities")

    def _declaration(self, *_: object) -> None:
        raise self._refuse("of a DTD only entities are allowed")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._elements += 1
        if self._depth > MAX_DEPTH:
            raise self._refuse(f"elements are nested more than {MAX_DEPTH} levels deep")
        if self._elements > MAX_ELEMENTS:
            raise self._refuse(f"there are more than {MAX_ELEMENTS} elements")
        if self._elements == 1 and self._references * self._longest > MAX_EXPANSION:
            raise self._refuse("the entities would expand to too much text")

    def _end(self, name: str) -> None:
        self._depth -= 1


def _refused(line: int, column: int, reason: str) -> InvalidRequest:
    return InvalidRequest(f"line {line}, column {column}: {reason}", field="owl", line=line, column=column)
