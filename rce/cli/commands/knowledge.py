"""`knowledge`: recipes, objects and environments that robots share."""

from __future__ import annotations

from pathlib import Path

from rce.api.knowledge import KINDS
from rce.cli.arguments import RUNNING, Argument, argument
from rce.cli.command import Command, Group, Lazy, Section

KIND = argument("kind", choices=KINDS, help="recipe, object or environment")
UID = argument("uid", metavar="UID", help="class.id")
AS_JSON = argument("--json", action="store_true", help="print JSON")
CLASS = argument(
    "--class", dest="cls", default="", metavar="CLASS", help="class, or one above it: IRI or its last part"
)
PREFIX = argument("--prefix", default="", help="beginning of the uid")
OF_KIND = argument("--kind", choices=KINDS, help="kind of the entries")
FUNCTIONS = {"import": "restore"}


def _command(
    name: str, summary: str, arguments: tuple[Argument, ...], *examples: str, description: str = ""
) -> Command:
    return Command(
        f"knowledge {name}",
        summary,
        Lazy("rce.cli.lazy.knowledge", FUNCTIONS.get(name, name)),
        arguments,
        examples,
        platform=RUNNING,
        section=Section.LOCAL,
        description=description,
    )


GROUP = Group("knowledge", "Recipes, objects and environments that robots share.")

COMMANDS = (
    _command(
        "add",
        "Add an entry to the knowledge repository, or a version to one of yours.",
        (
            KIND,
            UID,
            argument("owl", nargs="?", type=Path, metavar="FILE", help="OWL text: RDF/XML or Turtle"),
            argument("--description", metavar="TEXT", help="what it is"),
            argument(
                "--file",
                dest="files",
                action="append",
                type=Path,
                metavar="FILE",
                default=[],
                help="file of it; may be repeated",
            ),
            argument(
                "--map", type=Path, metavar="DIR", help="directory of a map of `rce map` or `rce map3d`: its files"
            ),
            argument("--public", action="store_true", help="let all users read it"),
            argument(
                "--share", dest="shared", action="append", default=[], metavar="USER", help="let this user read it"
            ),
            argument("--place", type=float, nargs=2, metavar=("LATITUDE", "LONGITUDE"), help="where it is, in degrees"),
            AS_JSON,
        ),
        "knowledge add recipe serve.drink serve_drink.owl --public",
        "knowledge add environment office.second --map map --place 47.37 8.54",
        description="Without FILE a new entry has an empty text, and one that exists keeps its text. What is not given "
        "stays as it is.",
    ),
    _command(
        "get",
        "Print the OWL text of an entry, or write it with the files of the entry to a directory.",
        (
            KIND,
            UID,
            argument("--version", type=int, metavar="NUMBER", help="another version than the newest"),
            argument("--out", type=Path, metavar="DIR", help="write UID.owl and the files there"),
        ),
        "knowledge get environment office.second --out office",
    ),
    _command(
        "search",
        "Search for entries; all conditions must fit.",
        (
            argument("text", nargs="*", metavar="WORD", help="word of description, labels, comments or names"),
            OF_KIND,
            PREFIX,
            CLASS,
            argument("--author", default="", metavar="USER", help="who added it"),
            argument("--near", type=float, nargs=2, metavar=("LATITUDE", "LONGITUDE"), help="around this place"),
            argument("--radius", type=float, default=1000.0, metavar="METRES", help="(default: %(default)s)"),
            AS_JSON,
        ),
        "knowledge search cup --class Vessel",
        "knowledge search --kind environment --near 47.37 8.54",
    ),
    _command(
        "query",
        "Answer a SPARQL query over all that you may read; each entry is a named graph.",
        (
            argument("query", metavar="QUERY", help="the query, or @FILE"),
            argument("--serql", action="store_true", help="SeRQL, in the shape that RoboEarth's clients sent"),
            AS_JSON,
        ),
        "knowledge query 'SELECT ?g ?c { GRAPH ?g { ?thing a ?c } } LIMIT 9'",
    ),
    _command("history", "List the versions of an entry.", (KIND, UID, AS_JSON), "knowledge history recipe serve.drink"),
    _command("remove", "Remove an entry of yours with all of its versions.", (KIND, UID)),
    _command(
        "subscribe",
        "Print changes of entries as they happen.",
        (
            argument("uid", nargs="?", default="", metavar="UID", help="one entry"),
            OF_KIND,
            PREFIX,
            CLASS,
            argument("--after", type=int, metavar="NUMBER", help="begin with the changes after this one"),
        ),
        "knowledge subscribe --class Cup",
        description="Prints one JSON object a line, and resumes when the connection breaks. Ctrl-C ends it.",
    ),
    _command(
        "export",
        "Write all entries that you may read, with all versions and files, to one archive.",
        (argument("archive", type=Path, metavar="FILE", help="ZIP file to write"),),
        "knowledge export knowledge.zip",
    ),
    _command(
        "import",
        "Add the entries of an archive; those that exist stay as they are.",
        (argument("archive", type=Path, metavar="FILE", help="archive of `knowledge export`"),),
        "knowledge import knowledge.zip",
    ),
)
