"""Calibration: whether the links are what the plan says, probed before a run and counted after it.

expected   what probes of a link should find, and how far they may be off it
schedule   plan and topology -> what each node sends, and when
estimate   what arrived -> delay, jitter, rate
calibrate  all of it on the nodes, again for what is off -> `Calibration`
losses     after a run: random loss from the shaper's counters
"""

from .calibrate import Calibration, calibrate
from .losses import Loss, check_losses, measure_losses

__all__ = ["Calibration", "Loss", "calibrate", "check_losses", "measure_losses"]
