"""Names of experiments and protocols, and counts in sentences."""

from __future__ import annotations

import re

PROTOCOL_NAMES = {"mqttxt": "MQTT-XT", "mavlink": "MAVLink"}
EXPERIMENT_NAMES = {f"scenario-{number}": f"Scenario {number}" for number in range(1, 6)}
EXPERIMENT_NAMES |= {"messages": "Message set"}
EXPERIMENT_WHAT = {
    "scenario-1": "arm, take off to 10 m, hold for 15 s, land, all disarmed",
    "scenario-2": "arm, take off, fly to a point of one's own, return and land, all disarmed",
    "scenario-3": "arm, take off, land, all disarmed",
    "messages": "ten kinds of messages, one at a time, to and from one drone",
    "scenario-4": "as scenario 2, with readings of a sensor carried to the ground station from each point",
    "scenario-5": "upload a survey of 100 items, arm, fly it, return and land, all disarmed",
}
_ITS_OWN_NAME = re.compile(r"^scenario-\d+ failed: ")
"""The prefix of the mission's reasons; the page shows the experiment already."""
_IN_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def name_of(protocol: str) -> str:
    """A protocol's name in text: MQTT-XT, MAVLink."""
    return PROTOCOL_NAMES.get(protocol, protocol)


def short_name(experiment: str, narrow: bool = False) -> str:
    """An experiment's name among others: 'scenario 1', or with `narrow` 'sc. 1'."""
    return experiment.replace("scenario-", "sc. " if narrow else "scenario ")


def plural(count: int | str, what: str) -> str:
    return f"{count} {what}" if count in (1, "one") else f"{count} {what}s"


def in_words(count: int) -> str:
    return _IN_WORDS[count] if count < len(_IN_WORDS) else str(count)


def fleet(fogs: int, drones: int) -> str:
    """'six drones on two fogs'"""
    return f"{plural(in_words(drones), 'drone')} on {plural(in_words(fogs), 'fog')}"


def listed(parts: list[str]) -> str:
    """'a', 'a and b', 'a, b and c'; empty without parts."""
    if not parts:
        return ""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def first_line(reason: str | None, most: int = 120) -> str:
    """A reason's first line, for use in a sentence; if it is cut, it ends in an ellipsis."""
    line = (reason or "no reason given").strip().splitlines()[0].rstrip()
    if line.endswith(":"):  # the lines that it announces, as 'its last log lines', are not shown
        line = line[: line.rfind(";")] if ";" in line else line
    line = _ITS_OWN_NAME.sub("", line.rstrip(" :;."))
    if len(line) <= most:
        return line
    whole = line[: most - 1].rpartition("; " if "; " in line[most // 2 : most - 1] else " ")[0] or line[: most - 1]
    return whole.rstrip(" ;,") + " …"
