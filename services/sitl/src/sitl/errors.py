"""What can be wrong with a flight: a setting, or the autopilot itself."""

from __future__ import annotations


class SitlError(Exception):
    """A setting that cannot work: the text names it, its value and what was expected."""

    exit_code = 2


class AutopilotDied(SitlError):
    """An autopilot that ended by itself, or never began."""

    exit_code = 1
