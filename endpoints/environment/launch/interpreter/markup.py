"""Launch files in XML and YAML: both are elements with attributes, which become actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import yaml

from endpoints.environment.launch.interpreter import actions, ros
from endpoints.environment.launch.interpreter.conditions import Condition, IfCondition, UnlessCondition
from endpoints.environment.launch.interpreter.context import LaunchError
from endpoints.environment.launch.interpreter.files import IncludeLaunchDescription
from endpoints.environment.launch.interpreter.grammar import parse, split

TYPES = {"str": str, "int": int, "float": float, "bool": bool, "auto": None}


@dataclass
class Element:
    """An element of XML, or a mapping of YAML."""

    tag: str
    line: int
    attributes: dict[str, str] = field(default_factory=dict)
    lists: dict[str, list[str]] = field(default_factory=dict)  # attributes that are lists; YAML only
    children: list[Element] = field(default_factory=list)

    def take(self, *names: str, default: str | None = None) -> str:
        """Remove an attribute, which may have several names, and return it; raise LaunchError if it is missing."""
        for name in names:
            if name in self.attributes:
                return self.attributes.pop(name)
        if default is None:
            raise LaunchError(f"the attribute {names[0]} is missing")
        return default

    def text(self, *names: str, default: str | None = None) -> list[Any]:
        """Remove an attribute and return its strings and substitutions."""
        return parse(self.take(*names, default=default))

    def of(self, tag: str) -> list[Element]:
        """Remove the children with a tag and return them."""
        found = [child for child in self.children if child.tag == tag]
        self.children = [child for child in self.children if child.tag != tag]
        return found


def read_xml(content: str) -> Element:
    """Return the root of an XML file; raise LaunchError if it is not well-formed."""
    parser = expat.ParserCreate()
    stack = [Element("", 0)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, parser.CurrentLineNumber, dict(attributes))
        stack[-1].children.append(element)
        stack.append(element)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise LaunchError(str(error)) from None
    return stack[0].children[0]


def read_yaml(content: str) -> Element:
    """Return the root of a YAML file; raise LaunchError if it is not valid."""
    try:
        root = yaml.compose(content, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise LaunchError(str(error)) from None
    if not isinstance(root, yaml.MappingNode) or [key.value for key, _ in root.value] != ["launch"]:
        raise LaunchError("the file must be a mapping with the single key `launch`")
    return _yaml_element("launch", *root.value[0])


def _yaml_element(tag: str, key: Any, value: Any) -> Element:
    element = Element(tag, key.start_mark.line + 1)
    if isinstance(value, yaml.MappingNode):
        for name, each in value.value:
            _add_yaml(element, name, each)
    elif isinstance(value, yaml.SequenceNode):
        _add_children(element, value)
    elif value.value:
        raise LaunchError(f"line {element.line}: {tag} is neither a mapping nor a list")
    return element


def _add_yaml(element: Element, name: Any, value: Any) -> None:
    if isinstance(value, yaml.ScalarNode):
        element.attributes[name.value] = value.value
    elif isinstance(value, yaml.MappingNode):
        element.children.append(_yaml_element(name.value, name, value))
    elif name.value == "children":
        _add_children(element, value)
    elif all(isinstance(item, yaml.ScalarNode) for item in value.value):
        element.lists[name.value] = [item.value for item in value.value]
    else:
        element.children += [_yaml_element(name.value, item, item) for item in value.value]


def _add_children(element: Element, items: Any) -> None:
    for item in items.value:
        if not isinstance(item, yaml.MappingNode):
            raise LaunchError(f"line {item.start_mark.line + 1}: an action is a mapping with its name as the key")
        element.children += [_yaml_element(key.value, key, value) for key, value in item.value]


def description(root: Element, file: str) -> actions.LaunchDescription:
    """Return the actions of a file.

    Raises:
        LaunchError: An element is not supported or wrong; names its line.
    """
    if root.tag != "launch":
        raise LaunchError(f"{file}:{root.line}: the root element is {root.tag}, not launch")
    return actions.LaunchDescription(_action(each, file) for each in root.children)


def _action(element: Element, file: str) -> Any:
    where = f"{file}:{element.line}"
    make = ELEMENTS.get(element.tag.replace("-", "_"))
    if make is None:
        raise LaunchError(f"{where}: {element.tag} is not supported; use one of {', '.join(sorted(ELEMENTS))}")
    try:
        condition = _condition(element)
        made = make(element, file)
        left = [*element.attributes, *element.lists, *(child.tag for child in element.children)]
        if left:
            raise LaunchError(f"{', '.join(sorted(left))} is not supported")
    except LaunchError as error:
        if str(error).startswith(f"{file}:"):  # of a child
            raise
        raise LaunchError(f"{where}: {element.tag}: {error}") from None
    made.condition, made.where = condition, where
    return made


def _condition(element: Element) -> Condition | None:
    if "if" in element.attributes and "unless" in element.attributes:
        raise LaunchError("it has both `if` and `unless`")
    if "if" in element.attributes:
        return IfCondition(element.text("if"))
    return UnlessCondition(element.text("unless")) if "unless" in element.attributes else None


def _arg(element: Element, _: str) -> actions.Action:
    default = element.text("default") if "default" in element.attributes else None
    choices = [choice.take("value") for choice in element.of("choice")] or None
    about = element.take("description", default="")
    return actions.DeclareLaunchArgument(
        element.take("name"), default_value=default, description=about, choices=choices
    )


def _node(element: Element, _: str) -> actions.Action:
    for name in ros.IGNORED:
        element.attributes.pop(name, None)
    shutdown = element.take("on_exit", default="")
    if shutdown not in ("", "shutdown"):
        raise LaunchError(f"on_exit may only be shutdown, not {shutdown}")
    return ros.Node(
        package=element.text("pkg"),
        executable=element.text("exec"),
        name=element.text("name", default=""),
        namespace=element.text("namespace", default=""),
        arguments=split(element.text("args", default="")),
        ros_arguments=split(element.text("ros_args", default="")),
        parameters=[_param(each) for each in element.of("param")],
        remappings=[(each.text("from"), each.text("to")) for each in element.of("remap")],
        additional_env={each.take("name"): each.text("value") for each in element.of("env")},
        respawn=element.text("respawn", default="false"),
        respawn_delay=_seconds(element.take("respawn_delay", default="0")),
        on_exit=actions.Shutdown() if shutdown else None,
    )


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise LaunchError(f"{text!r} is not a number of seconds") from None


def _param(element: Element) -> Any:
    if "from" in element.attributes:
        return ros.ParameterFile(element.text("from"), allow_substs=element.text("allow_substs", default="false"))
    return dict([_parameter(element)])


def _parameter(element: Element) -> tuple[str, Any]:
    name = element.take("name")
    if element.children:
        return name, dict(_parameter(each) for each in element.of("param"))
    kind = element.take("type", default="auto")
    if kind not in TYPES:
        raise LaunchError(f"param {name}: the type {kind} is not one of {', '.join(TYPES)}")
    if "value" in element.lists:
        return name, [_typed(each, kind) for each in element.lists.pop("value")]
    separator = element.take("value-sep", "value_sep", default="")
    value = element.take("value")
    return name, [_typed(each, kind) for each in value.split(separator)] if separator else _typed(value, kind)


def _typed(text: str, kind: str) -> ros.ParameterValue:
    parts: Any = parse(text)
    value = parts if any(not isinstance(part, str) for part in parts) else _Constant(text)
    return ros.ParameterValue(value, value_type=TYPES[kind])


class _Constant:
    """A text that is read as YAML, as the value of a substitution is."""

    def __init__(self, text: str) -> None:
        self.text = text

    def perform(self, _: Any) -> str:
        return self.text


def _include(element: Element, _: str) -> actions.Action:
    arguments = [(each.take("name"), each.text("value")) for each in (*element.of("arg"), *element.of("let"))]
    return IncludeLaunchDescription(element.text("file"), launch_arguments=arguments)


def _group(element: Element, file: str) -> actions.Action:
    scoped = element.take("scoped", default="true").lower() == "true"
    forwarding = element.take("forwarding", default="true").lower() == "true"
    kept = [(each.take("name"), each.text("value")) for each in element.of("keep")]
    children, element.children = element.children, []
    inner = [_action(each, file) for each in children]
    return actions.GroupAction(inner, scoped=scoped, forwarding=forwarding, launch_configurations=dict(kept))


def _timer(element: Element, file: str) -> actions.Action:
    children, element.children = element.children, []
    return actions.TimerAction(period=element.text("period"), actions=[_action(each, file) for each in children])


def _set_parameter(element: Element, _: str) -> actions.Action:
    name, value = _parameter(element)
    return ros.SetParameter(name, value)


def _pair(make: Callable[[Any, Any], actions.Action], first: str, second: str) -> Callable[[Element, str], Any]:
    return lambda element, _: make(element.text(first), element.text(second))


ELEMENTS: dict[str, Callable[[Element, str], Any]] = {
    "arg": _arg,
    "node": _node,
    "include": _include,
    "group": _group,
    "timer": _timer,
    "let": _pair(actions.SetLaunchConfiguration, "name", "value"),
    "set_env": _pair(actions.SetEnvironmentVariable, "name", "value"),
    "append_env": _pair(actions.AppendEnvironmentVariable, "name", "value"),
    "unset_env": lambda element, _: actions.UnsetEnvironmentVariable(element.text("name")),
    "log": lambda element, _: actions.LogInfo(msg=element.text("message")),
    "push_ros_namespace": lambda element, _: ros.PushRosNamespace(element.text("namespace")),
    "set_parameter": _set_parameter,
    "set_parameters_from_file": lambda element, _: ros.SetParametersFromFile(element.text("filename")),
    "set_remap": _pair(ros.SetRemap, "from", "to"),
    "set_use_sim_time": lambda element, _: ros.SetUseSimTime(element.text("value")),
}
