"""What the HTTP API shows and takes, shared by the Master and its clients: one type for each resource.

Things of the protocol have the names that they have in CC, CN and CX (`containerTag`, `endpointTag`, `tagA`); the rest
are single words. Every view of what belongs to a user begins with `user`. Times are seconds since 1970, sizes bytes.
"""

from rce.calls.watching import RosName as RosName
from rce.views.accounts import AuditView as AuditView
from rce.views.accounts import KeyView as KeyView
from rce.views.accounts import MadeKey as MadeKey
from rce.views.accounts import NewKey as NewKey
from rce.views.accounts import NewPassword as NewPassword
from rce.views.accounts import NewUser as NewUser
from rce.views.accounts import UsageView as UsageView
from rce.views.accounts import UserChanges as UserChanges
from rce.views.accounts import UserView as UserView
from rce.views.accounts import Whoami as Whoami
from rce.views.live import Deltas as Deltas
from rce.views.live import Event as Event
from rce.views.live import Greeting as Greeting
from rce.views.live import Kind as Kind
from rce.views.logs import LogLines as LogLines
from rce.views.machines import Invited as Invited
from rce.views.machines import MachineView as MachineView
from rce.views.machines import NewInvitation as NewInvitation
from rce.views.pages import Page as Page
from rce.views.resources import ConnectionView as ConnectionView
from rce.views.resources import EnvironmentView as EnvironmentView
from rce.views.resources import GroupView as GroupView
from rce.views.resources import InterfaceView as InterfaceView
from rce.views.resources import NodeView as NodeView
from rce.views.resources import ParameterView as ParameterView
from rce.views.resources import Rate as Rate
from rce.views.resources import RobotView as RobotView
from rce.views.resources import Usage as Usage
from rce.views.traces import HopView as HopView
from rce.views.traces import MessageTrace as MessageTrace
from rce.views.traces import Traced as Traced
from rce.views.wanted import NewConnection as NewConnection
from rce.views.wanted import NewEnvironment as NewEnvironment
from rce.views.wanted import NewInterface as NewInterface
from rce.views.wanted import NewNode as NewNode
from rce.views.wanted import NewParameter as NewParameter
