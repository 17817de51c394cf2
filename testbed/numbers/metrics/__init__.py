"""Metrics: an attempt's packets and events in numbers, and `metrics.json` of a series."""

from .series import METRICS_VERSION, measure_series, read_metrics
from .window import Window, mission_window

__all__ = ["METRICS_VERSION", "Window", "measure_series", "mission_window", "read_metrics"]
