"""What can be flown: experiments, factors, arms, profiles and protocols, and the check of user input."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any

from net.link_plan import SHAPERS

from ..errors import UserError
from .factors import FACTORS, Factors
from .fleet import MOST_ROUTED, Fleet
from .fleets import standard_fleet
from .machines import VARIABLE, Machine, machines_of
from .own_missions import check_mission
from .profiles.draws import seed_of
from .profiles.reading import Profile, read_profile
from .profiles.resolve import LENGTH_S, resolve
from .topology import Topology
from .typed import one_of, whole_number

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,59}")
_OTHER_RESULTS = ("links", "reproduction", "latest")
"""What is beside the experiments' folders, and what names the newest series of all."""
MESSAGES = "messages"
EXPERIMENTS = ("scenario-1", "scenario-2", "scenario-3", "scenario-4", "scenario-5", MESSAGES)
WITH_SENSORS = ("scenario-4",)
DEFAULT_SAMPLES, MOST_SAMPLES = 30, 600
"""The number of values in each series of a sensor, one per second."""
DEFAULT_COUNT, MOST_COUNT = 10, 1000
"""The number of messages of each kind in the message set."""
MESSAGE_LIMIT_S = 300.0
"""The time limit of one message of each kind, which usually takes 18 s."""
PROTOCOLS = ("mqttxt", "mavlink")
MOST_ATTEMPTS = 99


@dataclass(frozen=True)
class Arm:
    """A named preset of all factors."""

    name: str
    factors: Factors


_THESIS = Factors("px4-onboard", "one-by-one", 0, "per-uav", "on-change")
_FIVE_STATES = Factors("five-states", "concurrent", 1, "shared", "fixed")

ARMS = {
    arm.name: arm
    for arm in (
        Arm("thesis", _THESIS),
        Arm("thesis-concurrent", replace(_THESIS, commanding="concurrent")),
        Arm("five-states", _FIVE_STATES),
        Arm("five-states-bundled", replace(_FIVE_STATES, states="bundle")),
        Arm("gateway", Factors("px4-gcs", "concurrent", 1, "shared", "on-change", station="mavsdk")),
        Arm("direct", Factors("px4-onboard", "concurrent", 1, "direct", "on-change")),
    )
}


@dataclass(frozen=True)
class Plan:
    """A checked request for a series; `factors` are the arm's, except those that were set individually.

    `mission` is the file of a user's own mission, which then gives the experiment its name.
    """

    experiment: str
    attempts: int
    arm: Arm
    factors: Factors
    profile: Profile
    protocols: tuple[str, ...]
    shaper: str = SHAPERS[0]
    samples: int = DEFAULT_SAMPLES
    mission: Path | None = None
    count: int = DEFAULT_COUNT
    fleet: Fleet = field(default_factory=standard_fleet)
    page: int | None = None
    """The live page's port. Flights that it shows do not count: a station that watches opens gates."""
    order_seed: int | None = None
    """The seed of the order of protocols; None: the order alternates."""
    machines: tuple[Machine, ...] = ()
    """The machines besides this one that run a part of the fleet."""

    @property
    def is_message_set(self) -> bool:
        """Whether one UAV flies, message by message."""
        return self.experiment == MESSAGES

    @property
    def limit_s(self) -> float:
        """The time limit of a mission: a multiple of its usual time, so that only one that hangs is ended."""
        return LENGTH_S + (MESSAGE_LIMIT_S * self.count if self.is_message_set else 0.0)

    @property
    def has_sensors(self) -> bool:
        """Whether there are sensors' nodes, whose readings are collected."""
        return self.experiment in WITH_SENSORS

    @property
    def topology(self) -> Topology:
        """The nodes and links of the flights."""
        return self.fleet.topology(sensors=self.has_sensors)

    @property
    def label(self) -> str:
        """The arm with every factor in which the plan deviates from it, for the results' path."""
        own, flown = asdict(self.arm.factors), asdict(self.factors)
        deviating = [f"{name}-{flown[name]}" for name in FACTORS if flown[name] != own[name]]
        machines = [f"machines-{1 + len(self.machines)}"] if self.machines else []
        return "+".join([self.arm.name, *deviating, *(["page"] if self.page is not None else []), *machines])

    def is_secured(self, protocol: str) -> bool:
        """Whether a side's nodes have identities; over MAVLink they have none, whatever the factor."""
        return protocol == "mqttxt" and self.factors.security != "none"

    def through_gateway(self, protocol: str) -> bool:
        """Whether MAVSDK commands a side through `mqttxt gs mavlink`."""
        return protocol == "mqttxt" and self.factors.station == "mavsdk"

    @property
    def is_signed(self) -> bool:
        return self.factors.security == "signed"

    def order(self, attempt: int) -> tuple[str, ...]:
        """The order of protocols: drawn from `order_seed`, else as listed in odd attempts and reversed in even ones."""
        if self.order_seed is not None:
            draw = Random(seed_of(self.order_seed, self.experiment, self.label, self.profile.name, attempt))
            return tuple(draw.sample(self.protocols, len(self.protocols)))
        return self.protocols if attempt % 2 else self.protocols[::-1]


def make_plan(
    experiment: str,
    attempts: str = "1",
    arm: str = "thesis",
    profile: str = "ideal",
    protocols: str = "",
    overrides: Mapping[str, str] | None = None,
    shaper: str = SHAPERS[0],
    samples: str = str(DEFAULT_SAMPLES),
    count: str = str(DEFAULT_COUNT),
    fleet: Fleet | None = None,
) -> Plan:
    """Make a plan from user input.

    `experiment` is a name, or the path of a mission's .py file; `profile` a name, or the path of a file; `protocols` a
    list with commas, empty for all; `overrides` are factors by name, where an empty value keeps the arm's; `fleet` None
    is the experiments' fleet. Raises UserError that names the option, or the profile's file and field, the value and
    what was expected.
    """
    mission = Path(experiment).absolute() if experiment.endswith(".py") else None
    if mission is None:
        one_of("experiment", experiment, EXPERIMENTS)
    else:
        experiment = _name_of(mission)
    one_of("ARM", arm, tuple(ARMS))
    one_of("SHAPER", shaper, SHAPERS)
    chosen = tuple(part.strip() for part in protocols.split(",")) if protocols.strip() else PROTOCOLS
    for protocol in chosen:
        one_of("PROTOCOLS", protocol, PROTOCOLS)
    how_often = whole_number("ATTEMPTS", attempts, MOST_ATTEMPTS)
    values_each = whole_number("SAMPLES", samples, MOST_SAMPLES)
    messages_each = whole_number("COUNT", count, MOST_COUNT)
    factors = _factors(ARMS[arm], overrides or {})
    if factors.station == "mavsdk" and experiment in (*WITH_SENSORS, MESSAGES):
        raise UserError(f"STATION=mavsdk: expected another experiment than {experiment}, which MAVSDK cannot fly")
    if factors.air == "sn" and factors.security == "tls":
        raise UserError("AIR=sn: expected SECURITY=none or signed, because datagrams are not encrypted")
    if factors.air == "sn" and experiment == MESSAGES:
        raise UserError(f"AIR=sn: expected another experiment than {MESSAGES}, which counts TCP's acknowledgements")
    fleet = fleet or standard_fleet()
    if "mavlink" in chosen and not fleet.has_routers:
        expected = f"drones 1 to {MOST_ROUTED} over MAVLink, whose routers have system ids as well; or PROTOCOLS=mqttxt"
        raise UserError(f"drone {max(fleet.fog_of)} of the fleet: expected {expected}")
    links = read_profile(profile)
    plan = Plan(
        experiment,
        attempts=how_often,
        arm=ARMS[arm],
        factors=factors,
        profile=links,
        protocols=tuple(dict.fromkeys(chosen)),
        shaper=shaper,
        samples=values_each,
        mission=mission,
        count=messages_each,
        fleet=fleet,
    )
    resolve(links, plan.topology, experiment, 1, plan.limit_s)  # so that a link that does not exist is an error now
    return plan


def on_machines(plan: Plan, environment: Mapping[str, str]) -> Plan:
    """Spread the plan over this machine and those that MACHINES names; unchanged if that is empty.

    Raises UserError for an invalid address, and for a setting that needs all of the fleet on one machine.
    """
    machines = machines_of(environment, plan.fleet)
    if not machines:
        return plan
    for refused in _needs_one_machine(plan, environment):
        raise UserError(f"{refused} with {VARIABLE}")
    return replace(plan, machines=machines)


def _needs_one_machine(plan: Plan, environment: Mapping[str, str]) -> Iterator[str]:
    if plan.experiment in WITH_SENSORS:
        yield f"{plan.experiment}: its links open by where drones are, known on their machine alone: expected another"
    if plan.is_message_set:
        yield f"{plan.experiment}: it talks to the autopilot past all links, on one machine: expected another"
    if plan.factors.security != "none":
        yield f"SECURITY={plan.factors.security}: identities stay in the memory of one machine: expected none"
    for name in ("AUTOPILOT", "ROUTER"):
        if environment.get(name):
            yield f"{name}={environment[name]}: what it names is on this machine: expected none"
    if plan.page is not None:
        yield "PAGE=1: the page reads what autopilots write, on their machine: expected none"


def one_protocol(text: str) -> str:
    """Check the protocol of a fleet that is started by hand. Raises UserError for an unknown one, or for a list."""
    if text not in PROTOCOLS:
        raise UserError(f"PROTOCOLS={text}: expected {' or '.join(PROTOCOLS)}, one of them")
    return text


def _name_of(mission: Path) -> str:
    """The experiment's name of a user's own mission. Raises UserError if the file is no mission or its name invalid."""
    if not _NAME.fullmatch(mission.stem) or mission.stem in (*EXPERIMENTS, *_OTHER_RESULTS):
        expected = (
            f"a name of lower-case letters, digits, - and _ that no scenario has, nor {', '.join(_OTHER_RESULTS)}"
        )
        raise UserError(f"{str(mission)!r}: expected {expected}")
    check_mission(mission)
    return mission.stem


def _factors(arm: Arm, overrides: Mapping[str, str]) -> Factors:
    changed = {name: value for name, value in overrides.items() if value}
    for name, value in changed.items():
        one_of(name.upper(), value, FACTORS[name])
    own: dict[str, Any] = {**changed, **({"qos": int(changed["qos"])} if "qos" in changed else {})}
    return replace(arm.factors, **own)
