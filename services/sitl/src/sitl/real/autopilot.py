"""What every kind of real autopilot is prepared from, and what a kind has to say."""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..fleet import DroneConfig
from ..process import LinkConfig


@dataclass(frozen=True)
class Autopilot(ABC):
    """A real autopilot: from `folder`, in the folder `work`, whose logs go to `logs`. Every method raises SitlError.

    `onboard` is its link to whoever flies it; on another it sends to `witness`, a port of its loopback.
    """

    folder: Path
    work: Path
    logs: Path
    config: DroneConfig
    onboard: LinkConfig
    witness: int

    @abstractmethod
    def prepare(self) -> tuple[list[str], dict[str, str]]:
        """Its command line and environment, with all that they need in its folder."""

    @abstractmethod
    def questions(self) -> dict[str, list[str]]:
        """By parameter the command that reads it back."""

    @abstractmethod
    def check(self, answers: Mapping[str, str]) -> None:
        """Hold what was read back to what was to be."""

    def _make_folders(self, log: str, *more: Path) -> None:
        """Its folders anew; `log` is where it writes its logs in the one that it works in."""
        shutil.rmtree(self.work, ignore_errors=True)
        for folder in (self.work, self.logs, *more):
            folder.mkdir(parents=True, exist_ok=True)
        (self.work / log).symlink_to(self.logs.absolute())
