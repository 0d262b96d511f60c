from armrig.report.data_facts import treatment as treatment
from armrig.report.document import report as report
