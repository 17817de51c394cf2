"""Plans as QGroundControl writes them (`.plan`), for people and programs at the station."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, Self

from ..errors import ConfigurationError, PayloadError
from ..protocol.plans import PlanList, PlanObject, list_hash
from ..security.files import named_by_user, write
from .plan_reading import read
from .plan_writing import document_of

_ITEMS = {PlanList.MISSION: "mission items", PlanList.FENCE: "fence items", PlanList.RALLY: "rally points"}


@dataclass(frozen=True)
class Plan:
    """A mission, a geofence and rally points, as a drone gets them.

        outcome = await drone.upload(Plan.load("survey.plan"))

    Parameters:
        content: the three lists, item by item; a list that is None is left as it is on the drone.
        home: where the plan expects home: latitude and longitude in degrees, metres above mean sea level.
    """

    content: PlanObject
    home: tuple[float, float, float] | None = None

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a `.plan` file of QGroundControl.

        Parameters:
            path: the file.

        Raises:
            ConfigurationError: the file cannot be read, or is wrong: for each mistake one of its `lines` names the
                file, the item and the field.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ConfigurationError(f"{path}: expected a plan in JSON, got bytes that are no UTF-8") from error
        return cls.parse(text, str(path))

    @classmethod
    def parse(cls, text: str, name: str = "plan") -> Self:
        """Read the text of a `.plan` file.

        Parameters:
            text: the file's content.
            name: its name in errors.

        Raises:
            ConfigurationError: the text is wrong: for each mistake one of its `lines` names the item and the field.
        """
        try:
            document = json.loads(text, parse_constant=_refuse_constant)
            content, home = read(document)
            content.packed()
        except PayloadError as error:
            raise ConfigurationError(*(f"{name}: {line}" for line in error.lines)) from error
        except (ValueError, RecursionError) as error:
            raise ConfigurationError(f"{name}: {error}; expected a plan in JSON") from error
        return cls(content, home)

    def save(self, path: Path | str) -> None:
        """Write a `.plan` file that QGroundControl opens; an existing file is replaced, behind symbolic links.

        Parameters:
            path: the file.

        Raises:
            ConfigurationError: the file cannot be written, or is no regular one; an existing one is unchanged.
        """
        document = json.dumps(document_of(self.content, self.home), indent=4) + "\n"
        write(named_by_user(Path(path)), document.encode())

    def __str__(self) -> str:
        counts = ", ".join(f"{len(items)} {_ITEMS[kind]}" for kind, items in self.content.lists.items())
        return counts or "nothing"

    @property
    def mission_hash(self) -> bytes:
        """The hash that names its mission in `StartMission` and in the state `mission`: 16 bytes."""
        return list_hash(self.content.mission or ())


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"expected a number, got {text}")
