"""The packets table: every frame that entered a link and every message in it, from an attempt's captures."""

from .table import Packets, load

__all__ = ["Packets", "load"]
