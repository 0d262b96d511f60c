from armrig.report.document import report as report
from armrig.report.recording_facts import treatment as treatment
