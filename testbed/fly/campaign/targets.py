"""The plans of a campaign, in the order in which an interrupted run is worth most."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace

from net.link_plan import SHAPERS

from ...errors import UserError
from ...plan.experiments import ARMS, DEFAULT_COUNT, DEFAULT_SAMPLES, EXPERIMENTS, Plan, make_plan
from ...plan.fleets import fleet_of
from ...plan.order import FIRST_PROFILES, arms_in_order, experiments_in_order, profiles_in_order
from ...plan.profiles.reading import profile_names

PORT = 8786
"""The default port of a campaign's scheduler."""
CERTIFICATE = "campaign.pem"
"""The default file of the certificate that the machines of a campaign share."""
_ASKED_FIRST = FIRST_PROFILES[:2]


@dataclass(frozen=True)
class Wish:
    """The options of `make all` as typed: lists with commas, an empty one means all."""

    attempts: str = "1"
    experiments: str = ""
    arms: str = ""
    profiles: str = ""
    samples: str = str(DEFAULT_SAMPLES)
    count: str = str(DEFAULT_COUNT)
    shaper: str = SHAPERS[0]
    fleet: str = ""
    fogs: str = ""
    drones: str = ""
    scheduler: str = ""
    certificate: str = CERTIFICATE

    def typed(self) -> str:
        """The command that asks for the same again."""
        own = Wish()
        changed = [name for name in vars(own) if getattr(self, name) != getattr(own, name)]
        return " ".join(["make all", *(f"{name.upper()}={shlex.quote(getattr(self, name))}" for name in changed)])


def plans_of(wish: Wish) -> list[Plan]:
    """A plan for each series, the most wanted ones first, and breadth before depth.

    These are arm `thesis` on `ideal` and `thesis`; then its other first profiles, and the other arms on those two; then
    the rest. Raises UserError that names the option, the value and what was expected.
    """
    experiments = _listed("EXPERIMENTS", wish.experiments, EXPERIMENTS)
    arms = _listed("ARMS", wish.arms, tuple(ARMS))
    profiles = _listed("PROFILES", wish.profiles, tuple(profile_names()), paths=True)
    fleet = fleet_of({"FLEET": wish.fleet, "FOGS": wish.fogs, "DRONES": wish.drones})
    found = []
    for experiment in experiments_in_order(experiments):
        for profile in profiles_in_order(profiles):
            first = make_plan(
                experiment, wish.attempts, arms[0], profile, "", None, wish.shaper, wish.samples, wish.count, fleet
            )
            named = [ARMS[arm] for arm in arms_in_order(arms)]
            found += [replace(first, arm=arm, factors=arm.factors) for arm in named]
    return sorted(found, key=_late)


def _late(plan: Plan) -> int:
    """The rank of a series in the campaign; sorting keeps the order of series with the same rank."""
    profile, arm = plan.profile.name, plan.arm.name
    far = 0 if profile in _ASKED_FIRST else 1 if profile in FIRST_PROFILES else 2
    return far + (arm != next(iter(ARMS)))


def _listed(option: str, typed: str, known: Sequence[str], paths: bool = False) -> list[str]:
    """The names in a list with commas; with `paths` also one's own files."""
    if not typed.strip():
        return list(known)
    names = [name.strip() for name in typed.split(",")]
    for name in names:
        if name not in known and not (paths and name.endswith(".yaml")):
            raise UserError(f"{option}={typed}: {name!r}: expected a list of {', '.join(known)}")
    return names
