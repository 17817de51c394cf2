"""Calibration: checks that the links are as planned, by probes before a run and by counters after it.

expected   the figures that probes of a link should give, and their tolerances
schedule   plan and topology -> what each node sends, and when
estimate   probes that arrived -> delay, jitter, rate
calibrate  all of it on the nodes, repeated for figures that are off -> `Calibration`
losses     after a run: random loss from the shaper's counters
"""

from .calibrate import Calibration, calibrate
from .losses import LinkLoss, check_losses, measure_losses

__all__ = ["Calibration", "LinkLoss", "calibrate", "check_losses", "measure_losses"]
