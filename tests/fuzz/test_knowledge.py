"""REST and RoboEarth's own paths of the knowledge service: requests of users, mutated."""

from __future__ import annotations

import asyncio

import pytest

from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.requests import Parts, ask, mutated
from tests.support.fuzz.target import Target, port_of
from tests.support.knowledge import BED, CUP

pytestmark = pytest.mark.slow

AT_ONCE = 10
JSON = {"Content-Type": "application/json"}
RDF = {"kind": "object", "class": "bed", "id": "one", "owl": BED, "public": True, "shared": ["ann"]}
TURTLE = {"kind": "object", "class": "cup", "id": "blue", "owl": CUP, "location": {"latitude": 47.4, "longitude": 8.5}}
ENTRY = "/knowledge-service/entries/object/cup.blue"
SPARQL = "SELECT ?s (COUNT(?o) AS ?n) { GRAPH ?g { ?s ?p ?o } FILTER(?n > 1) } GROUP BY ?s ORDER BY ?n LIMIT 5"
SERQL = "SELECT source FROM CONTEXT source {S} k:height {H} USING NAMESPACE k = <http://example.org/kitchen.owl#>"
FORM = b'--x\r\nContent-Disposition: form-data; name="api_key"\r\n\r\nrce_x\r\n--x--\r\n'
REQUESTS: tuple[Parts, ...] = (
    ("POST", "/knowledge-service/entries", JSON, RDF),
    ("POST", "/knowledge-service/entries", JSON, TURTLE),
    ("PATCH", ENTRY, JSON, {"description": "the blue one", "owl": CUP, "public": True, "location": None}),
    ("DELETE", ENTRY, {}, b""),
    ("GET", "/knowledge-service/entries?kind=object&class=Vessel&text=blue&latitude=47&longitude=8&radius=9", {}, b""),
    ("GET", f"{ENTRY}/owl?version=1", {}, b""),
    ("GET", f"{ENTRY}/versions", {}, b""),
    ("DELETE", f"{ENTRY}/versions/1", {}, b""),
    ("POST", f"{ENTRY}/rating", JSON, {"rating": 7.5}),
    ("PUT", f"{ENTRY}/files/cup.stl", {"Content-Type": "application/octet-stream"}, b"solid cup"),
    ("GET", f"{ENTRY}/files/cup.stl?version=2", {"Range": "bytes=0-3"}, b""),
    ("POST", "/knowledge-service/query", JSON, {"query": SPARQL}),
    ("POST", "/knowledge-service/query", JSON, {"query": SERQL, "language": "serql"}),
    ("POST", "/knowledge-service/archive", {"Content-Type": "application/zip"}, b"PK\x03\x04"),
    ("GET", "/knowledge-service/usage", {}, b""),
    ("POST", "/api/0.1/object", JSON, {"api_key": "rce_x", "class": "cup", "id": "red", "object_description": CUP}),
    ("GET", "/api/0.1/object/cup", {}, b""),
    ("PUT", "/api/0.1/object/cup.blue", JSON, {"api_key": "rce_x", "description": "d"}),
    ("POST", "/api/0.1/serql", JSON, {"query": SERQL, "repository": "elements"}),
    ("POST", "/api/0.1/binary/objects/cup.blue", {"Content-Type": "multipart/form-data; boundary=x"}, FORM),
)


@pytest.mark.share(0.02)
async def test_each_request_of_a_user_is_answered(target: Target, cases: int, seed: str) -> None:
    mutator, port = Mutator(f"{seed} knowledge"), port_of(target.knowledge)
    for start in range(0, cases, AT_ONCE):
        requests = [mutated(mutator, "", REQUESTS) for _ in range(min(AT_ONCE, cases - start))]
        answers = await asyncio.gather(*(ask(port, each) for each in requests))
        for request, answer in zip(requests, answers, strict=True):
            assert answer[9:12].isdigit(), (request, answer)
            assert answer[9:12] < b"500" or answer[9:12] == b"503", (request, answer)
            assert b"internal error" not in answer, (request, answer)
    await target.check("requests of a user at the knowledge service")
