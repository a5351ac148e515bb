"""Messages between a robot and the platform: CC, DC, CN, CX, DM, ST, ER, as in the original RoboEarth Cloud Engine.

A text frame is `{"type": …, "data": …}`, with an optional `id` beside `type` (feature `ack`). `data` is decoded in a
second step. Unknown keys are ignored, as in the original.
"""

from rce.protocol.messages.commands import ALIASES as ALIASES
from rce.protocol.messages.commands import CN_ITEMS as CN_ITEMS
from rce.protocol.messages.commands import CX_ITEMS as CX_ITEMS
from rce.protocol.messages.commands import IMAGE_FORMATS as IMAGE_FORMATS
from rce.protocol.messages.commands import AddInterface as AddInterface
from rce.protocol.messages.commands import AddNode as AddNode
from rce.protocol.messages.commands import AddRecorder as AddRecorder
from rce.protocol.messages.commands import CodecName as CodecName
from rce.protocol.messages.commands import Command as Command
from rce.protocol.messages.commands import ConfigureComponents as ConfigureComponents
from rce.protocol.messages.commands import ConfigureConnections as ConfigureConnections
from rce.protocol.messages.commands import Connect as Connect
from rce.protocol.messages.commands import ContainerData as ContainerData
from rce.protocol.messages.commands import CreateContainer as CreateContainer
from rce.protocol.messages.commands import Decimation as Decimation
from rce.protocol.messages.commands import DeleteParameter as DeleteParameter
from rce.protocol.messages.commands import Delivery as Delivery
from rce.protocol.messages.commands import DestroyContainer as DestroyContainer
from rce.protocol.messages.commands import Disconnect as Disconnect
from rce.protocol.messages.commands import Format as Format
from rce.protocol.messages.commands import InterfaceType as InterfaceType
from rce.protocol.messages.commands import LeaveService as LeaveService
from rce.protocol.messages.commands import NodeRestart as NodeRestart
from rce.protocol.messages.commands import ParameterName as ParameterName
from rce.protocol.messages.commands import ParameterValue as ParameterValue
from rce.protocol.messages.commands import Qos as Qos
from rce.protocol.messages.commands import Rates as Rates
from rce.protocol.messages.commands import RemoveInterface as RemoveInterface
from rce.protocol.messages.commands import RemoveNode as RemoveNode
from rce.protocol.messages.commands import RemoveRecorder as RemoveRecorder
from rce.protocol.messages.commands import SetParameter as SetParameter
from rce.protocol.messages.commands import UseService as UseService
from rce.protocol.messages.data import MAX_MSG_ID as MAX_MSG_ID
from rce.protocol.messages.data import DataMessage as DataMessage
from rce.protocol.messages.data import GoalStatus as GoalStatus
from rce.protocol.messages.data import Phase as Phase
from rce.protocol.messages.frames import CURRENT_VERSION as CURRENT_VERSION
from rce.protocol.messages.frames import FEATURES as FEATURES
from rce.protocol.messages.frames import MINIMAL_VERSION as MINIMAL_VERSION
from rce.protocol.messages.frames import Frame as Frame
from rce.protocol.messages.frames import FrameId as FrameId
from rce.protocol.messages.frames import decode_as as decode_as
from rce.protocol.messages.frames import decode_frame as decode_frame
from rce.protocol.messages.large import LargeMessage as LargeMessage
from rce.protocol.messages.large import envelope_of as envelope_of
from rce.protocol.messages.large import split_large as split_large
from rce.protocol.messages.status import Ack as Ack
from rce.protocol.messages.status import ConnectionEvent as ConnectionEvent
from rce.protocol.messages.status import ConnectionState as ConnectionState
from rce.protocol.messages.status import DropEvent as DropEvent
from rce.protocol.messages.status import EnvironmentEvent as EnvironmentEvent
from rce.protocol.messages.status import Failure as Failure
from rce.protocol.messages.status import InterfaceStatus as InterfaceStatus
from rce.protocol.messages.status import LimitEvent as LimitEvent
from rce.protocol.messages.status import NodeEvent as NodeEvent
from rce.protocol.messages.status import RecorderEvent as RecorderEvent
from rce.protocol.messages.status import Session as Session
from rce.protocol.messages.status import Status as Status
from rce.protocol.messages.status import StatusData as StatusData
from rce.protocol.messages.status import UsedInterface as UsedInterface
from rce.protocol.messages.status import UsedService as UsedService
