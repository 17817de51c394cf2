"""What holds for all tests; how they share a machine is in `workers`, `lateness` and `soak`."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

pytest_plugins = ("tests.lateness", "tests.soak", "tests.workers")

# How long an example takes says how busy the machine is. The quick check tries fewer of them.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("any machine"), max_examples=20)
settings.load_profile("any machine")
