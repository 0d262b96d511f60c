"""The settings of all hypothesis tests.

No result depends on the speed of the machine or on an earlier run. An example has no deadline, each
run tries the same examples, and no file of earlier failures is kept. The options
`--hypothesis-profile drawn --hypothesis-seed SEED` try others.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile(
    "drawn",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    database=None,
    print_blob=True,
)
settings.register_profile("repeatable", settings.get_profile("drawn"), derandomize=True)
settings.load_profile("repeatable")
