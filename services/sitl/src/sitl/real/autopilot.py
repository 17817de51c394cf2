"""The interface of real autopilots: what each is prepared from, and what a kind implements."""

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
    """A real autopilot from `folder`, which runs in `work` and logs to `logs`. Every method raises SitlError.

    `onboard` is the link over which it is flown; on another one it sends to `witness`, a port of its loopback.
    """

    folder: Path
    work: Path
    logs: Path
    config: DroneConfig
    onboard: LinkConfig
    witness: int

    @abstractmethod
    def prepare(self) -> tuple[list[str], dict[str, str]]:
        """Fill its folder, and return its command line and environment."""

    @abstractmethod
    def questions(self) -> dict[str, list[str]]:
        """For each parameter, the command that reads it back."""

    @abstractmethod
    def check(self, answers: Mapping[str, str]) -> None:
        """Compare the parameters read back with those that were set."""

    def _make_folders(self, log: str, *more: Path) -> None:
        """Make its folders anew; `log` is the folder within `work` where it writes its logs."""
        shutil.rmtree(self.work, ignore_errors=True)
        for folder in (self.work, self.logs, *more):
            folder.mkdir(parents=True, exist_ok=True)
        (self.work / log).symlink_to(self.logs.absolute())
