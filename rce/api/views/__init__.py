"""Request and response types of the HTTP API: one for each resource, shared by the Master and its clients.

Fields that exist in the protocol have the names of CC, CN and CX (`containerTag`, `endpointTag`, `tagA`); the others
are single words. Every view of a user's resource begins with `user`. Times are seconds since 1970, sizes bytes.
"""

from rce.api.views.accounts import AuditView as AuditView
from rce.api.views.accounts import CreatedKey as CreatedKey
from rce.api.views.accounts import KeyView as KeyView
from rce.api.views.accounts import NewKey as NewKey
from rce.api.views.accounts import NewPassword as NewPassword
from rce.api.views.accounts import NewSecret as NewSecret
from rce.api.views.accounts import NewUser as NewUser
from rce.api.views.accounts import SecretView as SecretView
from rce.api.views.accounts import UsageView as UsageView
from rce.api.views.accounts import UserChanges as UserChanges
from rce.api.views.accounts import UserView as UserView
from rce.api.views.accounts import Whoami as Whoami
from rce.api.views.catalogue import InstanceView as InstanceView
from rce.api.views.catalogue import NewOffer as NewOffer
from rce.api.views.catalogue import NewUse as NewUse
from rce.api.views.catalogue import OfferedNode as OfferedNode
from rce.api.views.catalogue import OfferedPort as OfferedPort
from rce.api.views.catalogue import OfferView as OfferView
from rce.api.views.catalogue import Scale as Scale
from rce.api.views.live import Deltas as Deltas
from rce.api.views.live import Event as Event
from rce.api.views.live import Greeting as Greeting
from rce.api.views.live import Kind as Kind
from rce.api.views.logs import LogLines as LogLines
from rce.api.views.machines import Invited as Invited
from rce.api.views.machines import MachineView as MachineView
from rce.api.views.machines import NewInvitation as NewInvitation
from rce.api.views.machines import ServiceView as ServiceView
from rce.api.views.pages import Page as Page
from rce.api.views.requests import NewConnection as NewConnection
from rce.api.views.requests import NewEnvironment as NewEnvironment
from rce.api.views.requests import NewInterface as NewInterface
from rce.api.views.requests import NewNode as NewNode
from rce.api.views.requests import NewParameter as NewParameter
from rce.api.views.requests import NewRecorder as NewRecorder
from rce.api.views.resources import ConnectionView as ConnectionView
from rce.api.views.resources import EnvironmentView as EnvironmentView
from rce.api.views.resources import GroupView as GroupView
from rce.api.views.resources import InterfaceView as InterfaceView
from rce.api.views.resources import NodeEndView as NodeEndView
from rce.api.views.resources import NodeView as NodeView
from rce.api.views.resources import ParameterView as ParameterView
from rce.api.views.resources import Rate as Rate
from rce.api.views.resources import RecorderView as RecorderView
from rce.api.views.resources import RecordingPage as RecordingPage
from rce.api.views.resources import RecordingView as RecordingView
from rce.api.views.resources import RobotView as RobotView
from rce.api.views.resources import Usage as Usage
from rce.api.views.traces import HopView as HopView
from rce.api.views.traces import MessageTrace as MessageTrace
from rce.api.views.traces import Traced as Traced
from rce.control.calls.watching import RosAction as RosAction
from rce.control.calls.watching import RosName as RosName
from rce.control.calls.watching import RosPackage as RosPackage
