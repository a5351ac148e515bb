"""Handlers of the services of re_srvs: fields of requests in, fields of responses out. Without ROS."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from typing import Any

from rce.api.knowledge import Kind
from rce.errors import Unauthorized

from .repository import Repository

Fields = dict[str, Any]
Handler = Callable[[Any], Fields]
Make = Callable[..., Any]  # makes a message of fields

NOUNS: dict[Kind, tuple[str, str]] = {
    "recipe": ("ActionRecipe", "recipe"),
    "object": ("Object", "object"),
    "environment": ("Environment", "environment"),
}
"""Kinds in the names of types and of fields."""


def handlers(repository: Repository, file: Make, map_file: Make, names: Make) -> Mapping[str, Handler]:
    """Return the handler of each service by its type.

    Args:
        repository: The repository.
        file: Makes a re_msgs/File.
        map_file: Makes a re_msgs/RosFile.
        names: Makes a re_msgs/StringArray.
    """
    found: dict[str, Handler] = {"Request2DMap": lambda request: _map(repository, map_file, request)}
    for kind, (noun, field) in NOUNS.items():
        found |= _of_entries(repository, kind, noun, field, names)
    for kind, noun, uid in (("object", "Object", "objectUID"), ("environment", "Environment", "envUID")):
        found |= _of_files(repository, kind, noun, uid, file)
    return found


def _of_entries(repository: Repository, kind: Kind, noun: str, field: str, names: Make) -> dict[str, Handler]:
    """Return the services about entries of a kind. Recipes have no files."""
    has_files = kind != "recipe"
    plural = f"{field}s"

    def get(request: Any) -> Fields:
        item = repository.get(kind, getattr(request, f"{field}UID"))
        files = {"filenames": item.files, "fileURLs": item.urls} if has_files else {}
        return {field: item.text} | files

    def search(request: Any) -> Fields:
        items = repository.search(kind, request.searchID)
        response: Fields = {"uids": [item.uid for item in items], plural: [item.text for item in items]}
        if has_files:
            response["filenames"] = [names(list=item.files) for item in items]
            response["fileURLs"] = [names(list=item.urls) for item in items]
        return response

    def put(request: Any) -> Fields:
        check_key(request)
        files = {each.name: content_of(each) for each in request.files} if has_files else {}
        repository.set(kind, request.cls, request.id, request.description, getattr(request, field), files)
        return {}

    def update(request: Any) -> Fields:
        check_key(request)
        repository.update(kind, request.uid, request.description, getattr(request, field))
        return {}

    def remove(request: Any) -> Fields:
        check_key(request)
        repository.remove(kind, getattr(request, f"{field}UID"))
        return {}

    def query(request: Any) -> Fields:
        return {"result": repository.query(request.query)}

    return {
        f"Get{noun}": get,
        f"Search{noun}s": search,
        f"Set{noun}": put,
        f"Update{noun}": update,
        f"Del{noun}": remove,
        f"Query{noun}s": query,
    }


def _of_files(repository: Repository, kind: Kind, noun: str, uid: str, file: Make) -> dict[str, Handler]:
    """Return the services about files of entries of a kind; `uid` is the field of requests with the uid."""

    def get(request: Any) -> Fields:
        content = repository.file(kind, getattr(request, uid), request.filename)
        return {"file": file(name=request.filename, data=bytes_of(content))}

    def put(request: Any) -> Fields:
        check_key(request)
        repository.add_file(kind, getattr(request, uid), request.file.name, content_of(request.file))
        return {}

    def update(request: Any) -> Fields:
        check_key(request)
        repository.replace_file(kind, getattr(request, uid), request.file.name, content_of(request.file))
        return {}

    def remove(request: Any) -> Fields:
        check_key(request)
        repository.remove_file(kind, getattr(request, uid), request.filename)
        return {}

    what = f"{noun}BinaryFile"
    return {f"Get{what}": get, f"Set{what}": put, f"Update{what}": update, f"Del{what}": remove}


def _map(repository: Repository, map_file: Make, request: Any) -> Fields:
    image, meta = repository.map(request.envUID, request.targetMapName).items()
    return {
        "map": map_file(name=image[0], data=bytes_of(image[1])),
        "meta": map_file(name=meta[0], data=bytes_of(meta[1])),
    }


def check_key(request: Any) -> None:
    """Check that a request to write has an API key, as in the original. The environment itself says whose it is.

    Raises:
        Unauthorized: It has none.
    """
    if not request.apiKey:
        raise Unauthorized("the request has no apiKey", field="apiKey")


def content_of(file: Any) -> bytes:
    """Return the content of a re_msgs/File."""
    return bytes(memoryview(file.data).cast("B"))


def bytes_of(content: bytes) -> array[int]:
    """Return a content as the field `data` of a re_msgs/File."""
    return array("b", content)
