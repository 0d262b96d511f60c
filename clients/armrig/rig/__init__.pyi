from armrig.rig.client import BusyError as BusyError
from armrig.rig.client import RefusedError as RefusedError
from armrig.rig.client import Rig as Rig
from armrig.rig.client import RunEndedError as RunEndedError
from armrig.rig.session import NoReplyError as NoReplyError
from armrig.rig.session import RigError as RigError
