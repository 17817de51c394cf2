"""What a word about a command means, in plain English for somebody who has not read the specification."""

from __future__ import annotations

from ..core.printable import printable
from ..protocol.messages import Word
from ..protocol.words import (
    CERTIFICATE_EXPIRED,
    NO_DEADLINE,
    NOT_ALLOWED,
    NOT_AUDITED,
    NOT_IN_CONTROL,
    NOT_SIGNED,
)
from ..station.outcomes import Outcome

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
"""What each word says by itself."""

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
    "busy": "The drone is reserved for, or executes, another choice.",
    "cancelled": "A later command ended it.",
    "disarmed": "The drone is disarmed: arm it first.",
    "expired": "Its time to start had passed.",
    "journal": "The drone cannot write its journal.",
    "landed_state_unknown": "The autopilot does not say whether the drone is on the ground.",
    "lease_lost": "The station lost control of the drone.",
    "mode_changed": "Somebody else changed the flight mode, a pilot for example. A pilot always wins.",
    "no_ack": "The autopilot did not answer.",
    "no_beacon": "The drone's clock was not heard.",
    "no_hold": "The autopilot did not change to hold.",
    "no_lease": "This station does not control the drone.",
    "no_roster": "The fog did not say which drones it has.",
    "no_subscriber": "The drone is not connected to its fog.",
    "none_eligible": "No drone can go there; the reasons follow.",
    "on_ground": "The drone is on the ground: let it take off first.",
    "refused_once": "The autopilot refused one copy of it, and said nothing of the other.",
    "restarted": "The drone's program was started anew in between.",
    "retained": "The broker kept it from an earlier time.",
    "timeout": "It took longer than its limit.",
    "wrong_mode": "The autopilot did not take the flight mode that the command needs.",
}
"""What the specification's reasons say; an autopilot's own words are shown as they are."""

OF_ACTIVATOR = "The fog's activator says so; the drone has not signed it."
"""What it says in a fleet that signs, where a last word is not the drone's own (R12.11)."""
HELD = "Another ground station controls the drone."
"""What it says where the reason names that station (R6.6)."""


def in_plain_english(outcome: Outcome) -> str:
    """One or two sentences on an outcome; texts of others are printable."""
    text = WORDS[outcome.word] if outcome.observed else UNOBSERVED
    if outcome.settled:
        text = f"The truth, known afterwards. {text}"
    if outcome.reason:
        text = f"{text} {_reason(outcome.reason)}"
    return f"{text} {OF_ACTIVATOR}" if outcome.is_of_activator and outcome.is_last else text


def _reason(reason: str) -> str:
    if reason.startswith(f"{NOT_IN_CONTROL}, "):
        return HELD
    known = REASONS.get(reason.split(":")[0].split(",")[0].strip())
    return known if known is not None else f"Reason: {printable(reason)}"
