from armrig_core.control.control_law import ControlLaw as ControlLaw
from armrig_core.control.control_law import load_law as load_law

from armrig.control.conversion import control_law as control_law
from armrig.control.law_check import check_law as check_law
from armrig.control.loop_comparison import compare_loop as compare_loop
from armrig.control.pid_design import pid as pid
from armrig.control.state_feedback import lqg as lqg
from armrig.control.state_feedback import place as place
