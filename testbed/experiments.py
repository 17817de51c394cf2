"""What can be flown: experiments, arms, profiles, protocols, and the check of what a person typed."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import UserError

EXPERIMENTS = ("scenario-1",)
PROTOCOLS = ("mqttxt",)
PROFILES = ("ideal",)
MOST_ATTEMPTS = 99


@dataclass(frozen=True)
class Arm:
    """A named preset: how the fleet talks. `qos` is that of MQTT-XT's commands, results and states."""

    name: str
    qos: int
    states: str
    streams: str


ARMS = {"thesis": Arm("thesis", qos=0, states="on-change", streams="px4-onboard")}


@dataclass(frozen=True)
class Plan:
    """What a person asked for, checked."""

    experiment: str
    attempts: int
    arm: Arm
    profile: str
    protocols: tuple[str, ...]


def make_plan(experiment: str, attempts: str, arm: str, profile: str, protocols: str) -> Plan:
    """Raises UserError naming the option, its value and what was expected."""
    _one_of("scenario", experiment, EXPERIMENTS)
    _one_of("ARM", arm, tuple(ARMS))
    _one_of("PROFILE", profile, PROFILES)
    chosen = tuple(part.strip() for part in protocols.split(","))
    for protocol in chosen:
        _one_of("PROTOCOLS", protocol, PROTOCOLS)
    if not attempts.isascii() or not attempts.isdecimal() or not 1 <= int(attempts) <= MOST_ATTEMPTS:
        raise UserError(f"ATTEMPTS={attempts}: expected a whole number from 1 to {MOST_ATTEMPTS}")
    return Plan(experiment, int(attempts), ARMS[arm], profile, tuple(dict.fromkeys(chosen)))


def _one_of(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise UserError(f"{what}={value}: expected {'one of ' if len(known) > 1 else ''}{', '.join(known)}")
