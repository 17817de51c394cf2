"""The findings of a series in plain sentences, computed from its numbers."""

from __future__ import annotations

from ...numbers import words
from ...numbers.attempt_entry import OutcomeEntry
from ...numbers.quantities import COMMANDS_LOST, DELAY, FRAMES_LOST, MISSION, PACKETS, SIZE, STATES_LOST
from ...numbers.written import Metrics
from ...plan import wording
from . import message_sentences
from .comparison import completed, fleet_size, rows
from .figures.losses import Lost
from .message_set import is_message_set

_OF_RATIO = tuple((one.name, f"the {one.name}") for one in (PACKETS, SIZE, MISSION))
_SAME_TIME = 0.02
_LOSSES = (COMMANDS_LOST, STATES_LOST, FRAMES_LOST)


def finding(metrics: Metrics) -> str:
    """The finding in one sentence: MAVLink over MQTT-XT. Without a completed attempt on each side, it says so and gives
    no ratio."""
    sides = words.sides(metrics)
    if (of_kinds := message_sentences.finding(metrics)) is not None:
        return of_kinds
    if [protocol for protocol, side in sides if completed(side)] == ["mqttxt", "mavlink"]:
        return _compared(metrics)
    failed_first = sorted(sides, key=lambda one: bool(completed(one[1])))
    parts = [_one_side(metrics, protocol) for protocol, _ in failed_first]
    said = [f"{part[0].upper()}{part[1:]}." for part in parts]
    return " ".join([*said, "There is no ratio to make."] if len(sides) > 1 else said)


def basis(metrics: Metrics) -> str | None:
    """The basis of the finding: the other side's numbers, the fleet, the links, the number of attempts. None without a
    completed attempt on each side."""
    if (of_kinds := message_sentences.basis(metrics)) is not None:
        return of_kinds
    sides = dict(words.sides(metrics))
    if not all(completed(sides.get(protocol, {"attempts": [], "void": []})) for protocol in ("mqttxt", "mavlink")):
        return None
    mission, packets, bytes_ = _middles(metrics, "mqttxt")
    flown = {protocol: (len(completed(side)), len(side["attempts"])) for protocol, side in sides.items()}
    if set(flown.values()) == {(1, 1)}:
        how = "one attempt each"
    elif len(set(flown.values())) == 1 and all(done == of for done, of in flown.values()):
        how = f"medians of {flown['mqttxt'][0]} attempts each"
    else:
        parts = [f"{done} of {of} over {wording.name_of(protocol)}" for protocol, (done, of) in flown.items()]
        how = f"medians of the completed attempts, {wording.listed(parts)}"
    fleet = wording.fleet(*fleet_size(completed(sides["mqttxt"])[0])).capitalize()
    return (
        f"MQTT-XT took {mission}, {packets} packets and {bytes_}.{_delays(metrics)}{_losses(metrics)} "
        f"{fleet} flew {_experiment(metrics)} on links of profile {metrics['profile']}; {how}."
    )


def notes(metrics: Metrics) -> list[str]:
    """Warnings about the numbers: why attempts failed or are void, and which files were cut off."""
    said = []
    for protocol, side in words.sides(metrics):
        name = wording.name_of(protocol)
        for attempt in side["attempts"]:
            which = f"{name}, attempt {attempt['attempt']}"
            if attempt["status"] != "completed":
                said.append(f"{which} {attempt['status']}: {attempt['reason']}")
            if attempt["truncated"]:
                files = ", ".join(attempt["truncated"])
                said.append(f"{which}: cut off, and counted up to the cut: {files}; its counts are too low")
        said += [
            f"{name}, attempt {void['attempt']} is void, not counted: {void['reason']}"
            + (f" (the machine's load was {void['load']:.1f} at its end)" if "load" in void else "")
            for void in side["void"]
        ]
    return said


def not_completed(outcomes: dict[str, list[OutcomeEntry]], reason: str) -> list[str]:
    """The last words other than `completed` that `reason` does not have: 'drone 3: takeoff denied (not healthy)'."""
    return [
        f"drone {drone}: {entry['command']} {entry['word']}" + (f" ({entry['reason']})" if entry["reason"] else "")
        for drone, entries in outcomes.items()
        for entry in entries
        if entry["word"] != "completed" and f"drone {drone}: {entry['word']}" not in reason
    ]


def none_lost(sides: dict[str, dict[str, Lost]]) -> str | None:
    """A sentence in place of a figure if no link lost a frame; None if one did, or if nothing was counted."""
    if not sides or any(one.frames for links in sides.values() for one in links.values()):
        return None
    counts = [
        f"{sum(one.entered for one in links.values()):,} frames over {wording.name_of(p)}" for p, links in sides.items()
    ]
    return f"No link lost a frame: of {wording.listed(counts)} every one that entered a link left it."


def _compared(metrics: Metrics) -> str:
    ratios = {row.name: row.ratio for row in rows(metrics).values()}
    mission = ratios[MISSION.name]
    as_long = mission is not None and abs(mission - 1) <= _SAME_TIME
    names = [(name, what) for name, what in _OF_RATIO if not (as_long and name == MISSION.name)]
    parts = [words.times(ratio, what) for name, what in names if (ratio := ratios[name]) is not None]
    by = f": {wording.listed(parts)} of MQTT-XT" if parts else ""
    in_time = ", in about the same mission time" if as_long and parts else ""
    took, packets, bytes_ = _middles(metrics, "mavlink")
    return f"Over MAVLink the same mission took {took}, {packets} packets and {bytes_}{by}{in_time}."


def _delays(metrics: Metrics) -> str:
    """A sentence on how long commands took to reach a drone on each side; empty if one is unknown."""
    row = rows(metrics)[DELAY.key]
    if row.ratio is None:
        return ""
    mavlink, mqttxt = (row.cells[protocol].text for protocol in ("mavlink", "mqttxt"))
    return f" A command reached its drone in {mavlink} over MAVLink, in {mqttxt} over MQTT-XT (medians)."


def _losses(metrics: Metrics) -> str:
    """A sentence for each kind of loss that occurred."""
    said = []
    table = rows(metrics)
    for row in (table[quantity.key] for quantity in _LOSSES):
        if any(cell.value for cell in row.cells.values()):
            each = [f"{row.cells[p].text} over {wording.name_of(p)}" for p in ("mavlink", "mqttxt")]
            said.append(f" {row.name.capitalize()}: {', '.join(each)}.")
    return "".join(said)


def _middles(metrics: Metrics, protocol: str) -> tuple[str, str, str]:
    """Mission time, packets and bytes of one side, as text."""
    table = rows(metrics)
    mission, packets, size = (table[quantity.key].cells[protocol].text for quantity in (MISSION, PACKETS, SIZE))
    return mission, packets, size


def _one_side(metrics: Metrics, protocol: str) -> str:
    side, name = metrics["protocols"][protocol], wording.name_of(protocol)
    flown, done = side["attempts"], completed(side)
    if not flown:
        return f"over {name} no attempt counts ({wording.first_line(side['void'][0]['reason'])})"
    if not done:
        which = "the only attempt failed" if len(flown) == 1 else f"none of {len(flown)} attempts was completed"
        return f"over {name} {which} ({wording.first_line(flown[0]['reason'])})"
    mission, packets, size = _middles(metrics, protocol)
    much = "" if len(done) == 1 else " (medians)"
    how = "" if len(done) == len(flown) else f", in {len(done)} of {len(flown)} attempts"
    return (
        f"over {name} {wording.fleet(*fleet_size(done[0]))} flew {_experiment(metrics)} in {mission}, "
        f"with {packets} packets and {size} on all links{much}{how}"
    )


def _experiment(metrics: Metrics) -> str:
    name: str = metrics["experiment"]
    return "the message set" if is_message_set(metrics) else wording.EXPERIMENT_NAMES.get(name, name).lower()
