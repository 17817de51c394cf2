"""The meaning of words about commands, in plain English for readers who do not know the specification."""

from __future__ import annotations

import re
from dataclasses import replace

from ..core.printable import printable
from ..protocol.messages import Word
from ..protocol.names import in_fleet
from ..protocol.rankings import Candidate
from ..protocol.words import CERTIFICATE_EXPIRED, NO_DEADLINE, NOT_ALLOWED, NOT_AUDITED, NOT_IN_CONTROL, NOT_SIGNED
from ..station.outcomes import Outcome, PsmiList

WORDS = {
    Word.ACCEPTED: "The autopilot has accepted it and carries it out.",
    Word.IN_PROGRESS: "The drone is carrying it out.",
    Word.COMPLETED: "Done: the drone's own reports show the effect.",
    Word.DENIED: "Refused. It was not started.",
    Word.UNSUPPORTED: "This autopilot cannot do it. It was not started.",
    Word.FAILED: "It was started, and ended without success.",
    Word.EXPIRED: "It came too late. It was not started, and will not be.",
    Word.OVERTAKEN: "A later command came first. It was not started, and will not be.",
    Word.SUPERSEDED: "A later command took its place.",
    Word.UNREACHABLE: "It did not reach the drone. It was not started, and will not be.",
    Word.UNCONFIRMED: (
        "Nobody knows: it may have happened, and may still happen. Look at the drone before you command it again."
    ),
}
"""The meaning of each word alone."""

UNOBSERVED = "The autopilot has accepted it; nothing shows the effect."

REASONS = {
    NO_DEADLINE: "Its clock was not known yet; send the command again.",
    NOT_IN_CONTROL: "This station does not control the drone.",
    NOT_SIGNED: "The command was not signed for this drone.",
    NOT_ALLOWED: "This station's certificate does not give the right.",
    CERTIFICATE_EXPIRED: "This station's certificate has expired: only hold, land and return are taken.",
    NOT_AUDITED: "The audit log cannot be written.",
    "autopilot": "The autopilot refused and gave no reason.",
    "autopilot_lost": "The autopilot stopped reporting.",
    "autopilot_restarted": "The autopilot was started anew in between.",
    "busy": "The drone is reserved for, or executes, another choice.",
    "cancelled": "A later command ended it.",
    "command_int_only": "The autopilot takes this MAV_CMD as COMMAND_INT alone.",
    "command_long_only": "The autopilot takes this MAV_CMD as COMMAND_LONG alone.",
    "command_unsupported_mav_frame": "The autopilot does not take positions in this frame.",
    "component_not_enabled": "This component may not be commanded: the drone's --allow-component enables it.",
    "deadline_too_far": "Its deadline is more than 60 s ahead.",
    "disarmed": "The drone is disarmed: arm it first.",
    "expired": "Its time to start had passed.",
    "home_unknown": "The autopilot has not reported a home position yet.",
    "id_conflict": "Another command had the same number.",
    "in_air": "The drone is in the air already.",
    "journal": "The drone cannot write its journal.",
    "landed_state_unknown": "The autopilot does not say whether the drone is on the ground.",
    "lease_lost": "The station lost control of the drone.",
    "ledger_full": "Too many commands were sent in the last minutes; try again later.",
    "mav_cmd_not_enabled": "This MAV_CMD is guarded: the drone's --allow-mav-cmd enables it.",
    "mission_running": "The drone flies its mission: pause it first.",
    "mode_changed": "Somebody else changed the flight mode, a pilot for example. A pilot always wins.",
    "no_ack": "The autopilot did not answer.",
    "no_answer": "The autopilot did not answer.",
    "no_autopilot": "The drone has no heartbeat of its autopilot.",
    "no_beacon": "The drone's clock was not heard.",
    "no_hold": "The autopilot did not change to hold.",
    "no_journal": "The drone's journal does not reach back to it.",
    "no_lease": "This station does not control the drone.",
    "no_mission": "The drone has no mission.",
    "no_reservation": "The fog does not hold that reservation, or no longer.",
    "no_roster": "The fog did not say which drones it has.",
    "no_subscriber": "The drone is not connected to its fog.",
    "no_such_item": "The drone's mission does not have this item; how many it has follows.",
    "none_eligible": "No drone can go there; the reasons follow.",
    "none_left": "Every drone that could go there was asked, and none did.",
    "not_broadcastable": "This command is for one drone: name the drone.",
    "not_carried": "MAVLink cannot carry this value to the autopilot.",
    "not_in_control_of_autopilot": "The autopilot obeys another system.",
    "not_in_mission": "The drone does not fly a mission.",
    "not_staged": "The drone does not have the plan: upload it again.",
    "null_param": "This autopilot needs a number for each parameter.",
    "offboard_elsewhere": "The autopilot follows the set-points of somebody else.",
    "on_ground": "The drone is on the ground: let it take off first.",
    "other_plan": "The drone has another mission: upload this one first.",
    "other_than_reserved": "The fog has reserved a drone for another command.",
    "out_of_range": "The value is outside the parameter's documented range.",
    "parameter_not_enabled": "This parameter is guarded: the drone's --allow-parameter enables it.",
    "partial": "Nobody knows which plan the autopilot has now: upload it again.",
    "plan_busy": "Another change of the drone's plan is under way.",
    "refused_once": "The autopilot refused one copy of it, and said nothing of the other.",
    "restarted": "The drone's program was started anew in between.",
    "retained": "The broker kept it from an earlier time.",
    "temporarily_rejected": "The autopilot cannot do it now; try again later.",
    "timeout": "It took longer than its limit.",
    "too_many_reservations": "The fog holds too many reservations; try again later.",
    "unknown_mav_cmd": "MAVLink has no such MAV_CMD.",
    "unknown_message": "MAVLink has no such message.",
    "unknown_parameter": "The autopilot has no such parameter.",
    "unknown_state": "There is no such state, or it has no rate. A MAVLink message is named mavlink/NAME.",
    "use_typed_command": "There is a command for it: send that one instead.",
    "wrong_mode": "The autopilot did not take the flight mode that the command needs.",
    "wrong_value": "The parameter's type does not have this value.",
}
"""The meaning of the specification's reasons; an autopilot's own words are shown unchanged."""

OF_ACTIVATOR = "The fog's activator says so; the drone has not signed it."
"""Added in a fleet that signs, if a last word is not signed by the drone (R12.11)."""
HELD = "Another ground station controls the drone"
"""The text for a reason that names that station (R6.6)."""

LEFT_OUT = {
    NOT_IN_CONTROL: "this station does not control it",
    "busy": "busy with another choice",
    "disarmed": "disarmed",
    "on_ground": "on the ground",
    "out_of_range": "too little battery for the way",
    "tried": "asked before",
    "unreachable": "not reachable",
}
"""Reasons why a drone was left out of a choice; an unknown or stale state is named instead."""
_OF_STATE = re.compile(r"(unknown|stale)\((\w+)\)")
_KNOWN = {"unknown": "not known", "stale": "too old"}


def headline(outcome: Outcome) -> str:
    """An outcome such as `drone 1: takeoff superseded`, without the specification's code of the reason."""
    text = str(replace(outcome, reason=None, superseded_by=None))
    said = outcome.word.label
    return text.replace(said, said.replace("_", " "))


def code_of(said: Outcome | PsmiList) -> str:
    """The outcome or list in the specification's words, in one line."""
    return printable(str(said).replace("\n", ";"))


def in_plain_english(outcome: Outcome) -> str:
    """One or two sentences on an outcome; texts from other nodes are made printable."""
    text = WORDS[outcome.word] if outcome.observed else UNOBSERVED
    if outcome.settled:
        text = f"The truth, known afterwards. {text}"
    if outcome.reason:
        text = f"{text} {_reason(outcome.reason)}"
    return f"{text} {OF_ACTIVATOR}" if outcome.is_of_activator and outcome.is_last else text


def choice_in_plain_english(found: PsmiList) -> tuple[str, str]:
    """The drone that a fog chose, and the candidates."""
    chosen = "nobody" if found.chosen is None else f"drone {in_fleet(found.fleet, found.chosen)}"
    parts = []
    if found.listed:
        parts.append(f"Soonest first: {', '.join(_candidate(one) for one in found.listed)}.")
    if found.left_out:
        parts.append(f"Left out: {', '.join(f'drone {one.drone} ({why_left_out(one)})' for one in found.left_out)}.")
    return f"choice of fog {in_fleet(found.fleet, found.fog)}: {chosen}", " ".join(parts)


def why_left_out(candidate: Candidate) -> str:
    """Why a drone was left out of a choice."""
    reason = candidate.reason or ""
    of_state = _OF_STATE.fullmatch(reason)
    if of_state is not None:
        return f"{of_state[2].replace('_', ' ')} {_KNOWN[of_state[1]]}"
    code, detail = _parted(reason)
    if code == NOT_IN_CONTROL and detail:
        return f"controlled by {detail}"
    return LEFT_OUT.get(code, printable(reason))


def _candidate(one: Candidate) -> str:
    figures = [
        f"{value:.{digits}f} {unit}"
        for value, unit, digits in ((one.distance_m, "m", 0), (one.arrival_s, "s", 1))
        if value is not None
    ]
    return f"drone {one.drone} ({', '.join(figures)})" if figures else f"drone {one.drone}"


def _reason(reason: str) -> str:
    code, detail = _parted(reason)
    if code == NOT_IN_CONTROL and detail:
        return f"{HELD}: {detail}."
    known = REASONS.get(code)
    if known is None:
        return f"Reason: {printable(reason)}"
    return f"{known} ({detail})" if detail else known


def _parted(reason: str) -> tuple[str, str]:
    """A reason's code, and the printable text after it."""
    code, *details = re.split("[:,]", reason, maxsplit=1)
    return code.strip(), printable("".join(details).strip())
