from armrig.rig.client import Rig as Rig
from armrig.rig.replies import BusyError as BusyError
from armrig.rig.replies import RefusedError as RefusedError
from armrig.rig.replies import RunEndedError as RunEndedError
from armrig.rig.session import NoReplyError as NoReplyError
from armrig.rig.session import RigError as RigError
