"""Translation between the robots' messages, the records of the graph, and the arguments of control calls."""

from __future__ import annotations

from master.graph.records import Delivery, EnvironmentOptions, Interface, IoRates, Node, Parameter, Qos, Recorder
from rce.control.calls.endpoints import InterfaceSpec, NodeSpec, ParameterSpec, RecorderSpec
from rce.protocol import messages as m

SAME = ("image", "size", "cpu", "memory", "pids", "disk", "bandwidth", "gpus", "packages", "group", "restart")
"""Options with one name in `containerData` and in records."""


def options_from(data: m.ContainerData) -> EnvironmentOptions:
    """Return the options that `containerData` of a CC asks for."""
    return EnvironmentOptions(
        **{name: getattr(data, name) for name in SAME},
        io=IoRates(data.io.read, data.io.write),
        features=data.specialFeatures,
        variables=data.env,
        secrets=data.secrets,
        group_address=data.groupIP or data.groupIp,
    )


def container_data(options: EnvironmentOptions) -> m.ContainerData:
    """Return options as `containerData`, for task sets and for views."""
    return m.ContainerData(
        **{name: getattr(options, name) for name in SAME},
        io=m.Rates(options.io.read, options.io.write),
        specialFeatures=options.features,
        env=options.variables,
        secrets=options.secrets,
        groupIP=options.group_address,
    )


def node_from(owner: str, command: m.AddNode) -> Node:
    """Return the record of a node that a command adds to environment `owner`."""
    program, names = (command.pkg, command.exe, command.args), (command.name, command.namespace)
    return Node(owner, command.nodeTag, *program, *names, command.restart, command.launch)


def node_spec(node: Node) -> NodeSpec:
    """Return a node as its environment starts it."""
    names = node.name, node.namespace
    return NodeSpec(node.tag, node.package, node.executable, node.arguments, *names, node.launch)


def launched_node(launch: Node, spec: NodeSpec) -> Node:
    """Return the record of a node that a launch has started."""
    program = spec.pkg, spec.exe, spec.args
    return Node(launch.owner, spec.tag, *program, spec.name, spec.namespace, part_of=launch.tag)


def parameter_spec(parameter: Parameter) -> ParameterSpec:
    """Return a parameter as its environment sets it."""
    return ParameterSpec(parameter.name, parameter.value, parameter.node)


def recorder_from(owner: str, command: m.AddRecorder) -> Recorder:
    """Return the record of a recorder that a command adds to environment `owner`."""
    topics = ["/" + topic.lstrip("/") for topic in command.topics]
    return Recorder(owner, command.recorderTag, topics, command.maxSize, command.maxDuration)


def recorder_spec(recorder: Recorder) -> RecorderSpec:
    """Return a recorder as its environment starts it."""
    return RecorderSpec(recorder.tag, recorder.topics, recorder.max_size, recorder.max_duration)


def interface_from(id: str, owner: str, kind: str, command: m.AddInterface) -> Interface:
    """Return the record of an interface that a command adds to `owner`."""
    qos = Qos(command.qos.reliability, command.qos.durability, command.qos.history, command.qos.depth)
    wanted, decimate = command.delivery, command.delivery.decimate
    smaller = (wanted.fields, decimate.step, decimate.size)
    delivery = Delivery(wanted.priority, wanted.maxAge, wanted.rate, *smaller)
    named = (command.interfaceTag, kind, command.className, command.addr)
    return Interface(id, owner, *named, qos, command.format, delivery=delivery, codec=command.codec)


def qos_message(qos: Qos) -> m.Qos:
    """Return quality of service as robots and views see it."""
    return m.Qos(qos.reliability, qos.durability, qos.history, qos.depth)


def delivery_message(delivery: Delivery) -> m.Delivery:
    """Return how messages cross the line, as robots and views see it."""
    decimate = m.Decimation(delivery.step, delivery.size)
    return m.Delivery(delivery.priority, delivery.max_age, delivery.rate, delivery.fields, decimate)


def interface_spec(interface: Interface) -> InterfaceSpec:
    """Return an interface as its endpoint makes it."""
    return InterfaceSpec(
        interface.id,
        interface.owner,
        interface.tag,
        interface.kind,
        interface.type,
        interface.address,
        qos_message(interface.qos),
        interface.format,
        delivery_message(interface.delivery),
        interface.codec,
    )
