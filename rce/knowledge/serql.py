"""Translation of SeRQL to SPARQL, for queries in the shape that RoboEarth's clients send.

Understood is `SELECT [DISTINCT] names|* FROM [CONTEXT name] path, … [WHERE …] [LIMIT n] [OFFSET n]
[USING NAMESPACE prefix = <iri>, …]`. A path is `{S} p {O}`, continued by ` q {P}` or `; q {P}`. Conditions compare
(`=`, `!=`, `<`, `>`, `LIKE`) and are joined by AND and OR. Of SeRQL's rest only SPARQL can say as much.
Reference: J. Broekstra, A. Kampman, "SeRQL: An RDF Query and Transformation Language", 2004.
"""

from __future__ import annotations

import json
import re

from rce.errors import InvalidRequest

TOKEN = re.compile(
    r"""\s+ | (?P<iri><!?[^<>\s"{}|^`\\]+>)
    | (?P<literal>"(?:[^"\\\n]|\\.)*"(?:@[A-Za-z-]+|\^\^(?:<[^<>\s]+>|[\w-]*:[\w.-]+))?)
    | (?P<number>-?\d+(?:\.\d+)?) | (?P<name>[A-Za-z_][\w.-]*:[\w.-]*) | (?P<word>[A-Za-z_]\w*)
    | (?P<sign>!=|<=|>=|[{}(),;*=<>])""",
    re.VERBOSE,
)
KNOWN = {
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
    "owl": "http://www.w3.org/2002/07/owl#",
    "xsd": "http://www.w3.org/2001/XMLSchema#",
}
"""Prefixes that SeRQL knows without being told."""
KEYWORDS = {"SELECT", "DISTINCT", "FROM", "CONTEXT", "WHERE", "AND", "OR", "LIKE", "IGNORE", "CASE", "LIMIT", "OFFSET"}
KEYWORDS |= {"USING", "NAMESPACE"}


def translate(query: str) -> str:
    """Return a SeRQL query as SPARQL.

    Raises:
        InvalidRequest: It is malformed, or of another shape.
    """
    try:
        return _Translator(query).query()
    except RecursionError:
        raise _refused("it is nested too deeply") from None


class _Translator:
    """Recursive descent over the tokens of a query."""

    def __init__(self, text: str) -> None:
        self._tokens: list[tuple[str, str]] = []
        self._position = self._unnamed = 0
        start = 0
        while start < len(text):
            match = TOKEN.match(text, start)
            if match is None:
                raise _refused(f"{text[start : start + 30]!r} is not understood")
            if match.lastgroup is not None:
                self._tokens.append((match.lastgroup, match[0]))
            start = match.end()

    def query(self) -> str:
        """Translate the whole query."""
        self._expect("SELECT")
        head = "SELECT " + ("DISTINCT " if self._take("DISTINCT") else "") + self._columns()
        body = ""
        while self._take("FROM"):
            graph = self._node() if self._take("CONTEXT") else ""
            triples = self._paths()
            body += f"GRAPH {graph} {{ {triples} }} " if graph else f"{triples} "
        if not body:
            raise _refused("FROM is missing")
        if self._take("WHERE"):
            body += f"FILTER ({self._condition()}) "
        tail = "".join(f" {word} {self._number()}" for word in ("LIMIT", "OFFSET") if self._take(word))
        prefixes = KNOWN | self._namespaces()
        if self._position < len(self._tokens):
            raise _refused(f"{self._tokens[self._position][1]!r} is not understood")
        lines = "".join(f"PREFIX {name}: <{iri}>\n" for name, iri in prefixes.items())
        return f"{lines}{head} WHERE {{ {body}}}{tail}"

    def _columns(self) -> str:
        if self._take("*"):
            return "*"
        names = [self._variable()]
        while self._take(","):
            names.append(self._variable())
        return " ".join(names)

    def _paths(self) -> str:
        triples = self._path()
        while self._take(","):
            triples += self._path()
        return triples

    def _path(self) -> str:
        subject, triples = self._braced(), ""
        start = subject
        while True:
            predicate, target = self._node(), self._braced()
            triples += f"{start} {predicate} {target} . "
            if self._take(";"):
                start = subject
            elif self._kind() in ("iri", "name", "word") and not self._is_keyword():
                start = target
            else:
                return triples

    def _braced(self) -> str:
        self._expect("{")
        if self._take("}"):
            self._unnamed += 1
            return f"?unnamed{self._unnamed}"
        node = self._node()
        self._expect("}")
        return node

    def _condition(self) -> str:
        text = self._comparison()
        while True:
            if self._take("AND"):
                text += f" && {self._comparison()}"
            elif self._take("OR"):
                text += f" || {self._comparison()}"
            else:
                return text

    def _comparison(self) -> str:
        if self._take("("):
            inner = self._condition()
            self._expect(")")
            return f"({inner})"
        left = self._node()
        if self._take("LIKE"):
            pattern = self._next("literal")
            flags = ', "i"' if self._take("IGNORE") and self._expect("CASE") else ""
            expression = ".*".join(re.escape(part) for part in _content(pattern).split("*"))
            return f"REGEX(STR({left}), {json.dumps(f'^{expression}$')}{flags})"
        for sign in ("=", "!=", "<=", ">=", "<", ">"):
            if self._take(sign):
                return f"{left} {sign} {self._node()}"
        raise _refused(f"after {left} a comparison is missing")

    def _namespaces(self) -> dict[str, str]:
        found: dict[str, str] = {}
        if not self._take("USING"):
            return found
        self._expect("NAMESPACE")
        while True:
            name = self._next("word")
            self._expect("=")
            found[name] = self._next("iri").strip("<!>")
            if not self._take(","):
                return found

    # --- tokens ------------------------------------------------------------------------------------------------------

    def _node(self) -> str:
        kind = self._kind()
        if kind == "word" and not self._is_keyword():
            return self._variable()
        if kind not in ("iri", "literal", "number", "name"):
            raise _refused(f"a variable, name or literal is missing at {self._text()!r}")
        return self._next(kind).replace("<!", "<")

    def _variable(self) -> str:
        if self._is_keyword():
            raise _refused(f"a variable is missing at {self._text()!r}")
        return f"?{self._next('word')}"

    def _number(self) -> str:
        return self._next("number")

    def _kind(self) -> str:
        return self._tokens[self._position][0] if self._position < len(self._tokens) else ""

    def _text(self) -> str:
        return self._tokens[self._position][1] if self._position < len(self._tokens) else "the end"

    def _is_keyword(self) -> bool:
        return self._text().upper() in KEYWORDS

    def _next(self, kind: str) -> str:
        if self._kind() != kind:
            raise _refused(f"a {kind} is missing at {self._text()!r}")
        text = self._text()
        self._position += 1
        return text

    def _take(self, text: str) -> bool:
        if self._position < len(self._tokens) and self._text().upper() == text:
            self._position += 1
            return True
        return False

    def _expect(self, text: str) -> bool:
        if not self._take(text):
            raise _refused(f"{text} is missing at {self._text()!r}")
        return True


def _content(literal: str) -> str:
    """Return the text of a literal, without its language or type."""
    escapes = {"n": "\n", "r": "\r", "t": "\t"}
    return re.sub(r"\\(.)", lambda found: escapes.get(found[1], found[1]), literal[1 : literal.rindex('"')])


def _refused(reason: str) -> InvalidRequest:
    text = "use SPARQL; of SeRQL only SELECT … FROM [CONTEXT c] {S} p {O} … WHERE … USING NAMESPACE … is understood"
    return InvalidRequest(f"SeRQL: {reason}: {text}", field="query")
