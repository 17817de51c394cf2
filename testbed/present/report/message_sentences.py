"""The findings of a message set in plain sentences, computed from its numbers."""

from __future__ import annotations

from ...numbers import words
from ...numbers.kinds import KindOnSide
from ...numbers.written import Metrics
from ...plan import wording
from .comparison import completed
from .message_set import KindRow, is_message_set, rows, totals

_FORMS = {"command": "a command", "state": "a state"}


def finding(metrics: Metrics) -> str | None:
    """MAVLink's frames and bytes as multiples of MQTT-XT's; None without a completed attempt on each side."""
    both = _both(metrics)
    if not both:
        return None
    counted = [f"{_FORMS[row.form]} {_times(row, 'with_states')}" for row in both]
    alone = [f"{_FORMS[row.form]} {_times(row, 'alone')}" for row in both]
    return (
        f"Over MAVLink, with all that went over the links meanwhile: {'; '.join(counted)} of MQTT-XT. "
        f"Of its own frames alone: {'; '.join(alone)}."
    )


def basis(metrics: Metrics) -> str | None:
    """The basis of the finding: amounts, delays, losses, the thesis's ratios, the number of attempts."""
    both = _both(metrics)
    if not both:
        return None
    said = [_amounts(row) for row in both]
    said += [_delays(row) for row in both if all(side.delay_ms is not None for side in row.sides.values())]
    lost = [_lost(row) for row in both if any(side.loss.lost for side in row.sides.values())]
    said += lost or ["No message was lost on either side."]
    said.append(_thesis(rows(metrics)))
    said.append(_how(metrics, both))
    return " ".join(said)


def shortfalls(metrics: Metrics) -> list[str]:
    """A line per kind with failed calls or late values: 'MAVLink, takeoff: 3 of 10 calls were not acknowledged (…)'."""
    said = []
    for row in rows(metrics):
        for protocol, side in row.sides.items():
            if side.received < side.asked:
                what = "calls were not acknowledged" if row.form == "command" else "values were not there in time"
                why = ", ".join(f"{count} {reason}" for reason, count in side.failed.items())
                missing = side.asked - side.received
                said.append(
                    f"{wording.name_of(protocol)}, {row.name}: {missing:,} of {side.asked:,} {what}"
                    + (f" ({why})" if why else "")
                )
    return said


def _both(metrics: Metrics) -> list[KindRow]:
    """The mean command and the mean state, as far as both sides have them; empty for another experiment."""
    if not is_message_set(metrics):
        return []
    return [row for row in totals(metrics) if {"mavlink", "mqttxt"} <= set(row.sides)]


def _times(row: KindRow, how: str) -> str:
    """'25 times the packets and 20 times the bytes'."""
    named = (("packets", "the packets"), ("bytes", "the bytes"))
    parts = [words.times(ratio, what) for name, what in named if (ratio := row.ratio(how, name)) is not None]
    return wording.listed(parts)


def _amounts(row: KindRow) -> str:
    each = [f"{_amount(row.sides[p])} over {wording.name_of(p)}" for p in ("mqttxt", "mavlink")]
    return f"For {_FORMS[row.form]} that is {' and '.join(each)}."


def _amount(side: KindOnSide) -> str:
    return f"{words.digits(side.with_states.packets)} frames with {words.size(side.with_states.bytes)}"


def _delays(row: KindRow) -> str:
    where = "its drone" if row.form == "command" else "the ground station"
    each = [f"{words.milliseconds(row.sides[p].delay_ms)} over {wording.name_of(p)}" for p in ("mqttxt", "mavlink")]
    return f"{_FORMS[row.form].capitalize()} reached {where} in {', in '.join(each)} (means)."


def _lost(row: KindRow) -> str:
    each = [f"{row.sides[p].lost.text} over {wording.name_of(p)}" for p in ("mqttxt", "mavlink")]
    return f"{row.form.capitalize()}s lost: {', '.join(each)}."


def _thesis(table: list[KindRow]) -> str:
    """The thesis's packet ratios for the kinds that were flown."""
    parts = []
    for form, label in (("command", "commands"), ("state", "states")):
        ratios = [ratio for row in table if row.form == form and (ratio := row.printed_ratio("packets")) is not None]
        if ratios:
            parts.append(f"{words.ratio(min(ratios))} to {words.ratio(max(ratios))} times the packets for {label}")
    return f"The thesis has {wording.listed(parts)}."


def _how(metrics: Metrics, both: list[KindRow]) -> str:
    counts = {p: len(completed(side)) for p, side in words.sides(metrics)}
    attempts = set(counts.values())
    if attempts == {1}:
        how = "one attempt each"
    elif len(attempts) == 1:
        how = f"means of {attempts.pop()} attempts each"
    else:
        how = f"means of {wording.listed([f'{n} attempts over {wording.name_of(p)}' for p, n in counts.items()])}"
    kinds = completed(metrics["protocols"]["mqttxt"])[0]["message_set"] or {}
    each = next(iter(kinds.values()))["asked"]
    return f"{each:,} of each kind, one drone, on links of profile {metrics['profile']}; {how}."
