"""The message set's tables: each kind on each side, per message, and the thesis's figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import mean

from ...numbers.kinds import KindOnSide, form_of, kinds_of, means_of
from ...numbers.observed import observe
from ...numbers.quantity import quotient
from ...numbers.written import Metrics
from . import thesis

EXPERIMENT = thesis.MESSAGE_SET


@dataclass(frozen=True)
class KindRow:
    """A kind on all sides, and the thesis's figures of it by protocol (`thesis.of_kind`).

    `printed_frame` has the thesis's bytes per packet; `computed`: its MQTT-XT bytes are no measurement.
    """

    name: str
    form: str
    sides: Mapping[str, KindOnSide]
    printed: dict[str, dict[str, float]]
    printed_frame: dict[str, int]
    computed: bool

    def amounts(self, how: str, what: str) -> dict[str, float]:
        """By protocol the `packets` or `bytes` per message, counted `with_states` or `alone`."""
        return {p: getattr(getattr(side, how), what) for p, side in self.sides.items()}

    def ratio(self, how: str, what: str) -> float | None:
        """MAVLink / MQTT-XT of these amounts; None if one is missing."""
        by = self.amounts(how, what)
        return quotient(by.get("mavlink"), by.get("mqttxt"))

    def printed_ratio(self, what: str) -> float | None:
        """The thesis's ratio of `packets` or `bytes`."""
        by = self.printed.get(what, {})
        return quotient(by.get("mavlink"), by.get("mqttxt"))


def is_message_set(metrics: Metrics) -> bool:
    return bool(metrics["experiment"] == EXPERIMENT)


def rows(metrics: Metrics) -> list[KindRow]:
    """A row for each kind that a completed attempt has: commands, then states."""
    return [
        KindRow(
            name,
            form_of(name),
            sides,
            thesis.of_kind(name),
            thesis.packet_sizes().get(name, {}),
            thesis.bytes_were_computed(name),
        )
        for name, sides in kinds_of(observe(metrics["protocols"])).items()
    ]


def totals(metrics: Metrics) -> list[KindRow]:
    """A row for one command and one for one state: means over the kinds of each form that all sides have."""
    found = []
    for form, (names, sides) in means_of(kinds_of(observe(metrics["protocols"]))).items():
        of_kind = [thesis.of_kind(name) for name in names]
        printed = {what: {p: mean(one[what][p] for one in of_kind) for p in of_kind[0][what]} for what in of_kind[0]}
        computed = any(thesis.bytes_were_computed(name) for name in names)
        found.append(KindRow(f"mean {form}", form, sides, printed, {}, computed))
    return found
