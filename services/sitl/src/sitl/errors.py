"""The errors of a flight: in a setting, or of the autopilot itself."""

from __future__ import annotations


class SitlError(Exception):
    """A setting that cannot work: the text names it, its value and what was expected."""

    exit_code = 2


class AutopilotDied(SitlError):
    """An autopilot that ended of its own accord, or did not start."""

    exit_code = 1
