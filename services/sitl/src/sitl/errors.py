"""The error of the stand-in that a person causes."""

from __future__ import annotations


class SitlError(Exception):
    """A setting that cannot work: the text names it, its value and what was expected."""
