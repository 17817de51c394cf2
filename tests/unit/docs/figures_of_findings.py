"""The figures in the text of docs/results.md, made from the series of docs/findings.

Each function yields passages: the figures of one paragraph, bullet or table row, in their order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from statistics import median
from typing import Any

from testbed.numbers import words
from testbed.numbers.observed import Loss, observe_attempt
from testbed.numbers.quantities import COMMAND_BYTES, COMMANDS_LOST, STATES_LOST
from testbed.numbers.quantity import QuantityFigure, Share
from testbed.plan import wording
from testbed.present.report.comparison import completed
from testbed.present.summary.cells import SIDES, Cell
from testbed.present.summary.claims import claims
from testbed.present.summary.kinds import HEADINGS, rows_of
from testbed.present.summary.numbers import TextPair, numbers_of
from testbed.present.summary.traffic import Bytes, bytes_of

PX4 = "thesis"
"""The arm in which PX4 streams its onboard set and drones are asked one by one."""
FIVE, BUNDLED = "five-states", "five-states-bundled"
STATES = ("battery", "flight_mode", "groundspeed", "heading", "location")
"""The five, which every drone publishes at a rate in those arms."""
STREAMED = (
    *(("scenario-1", arm) for arm in (PX4, "thesis-concurrent", "direct")),
    *((f"scenario-{number}", PX4) for number in (2, 3, 4)),
)
"""Where PX4's onboard streams are flown on the links of `thesis`."""
OTHER_PROFILES = ("3g", "bursty", "edge", "geo", "geo-2s", "lan", "leo", "sik")
"""Where one attempt of `five-states-bundled` was flown."""
LINKS_OF_A_CHAIN = 3
"""Between a drone and the ground station."""
COLUMNS = [f"{HEADINGS[at - 1]} ×" if name == "×" else name for at, name in enumerate(HEADINGS)]
"""Of the message set's table; a ratio is named after the column that it is of."""


class Findings:
    """The cells by experiment, arm and profile, and what the tables have of them."""

    def __init__(self, cells: Sequence[Cell]) -> None:
        self._cells = {(cell.experiment, cell.arm, cell.profile): cell for cell in cells}

    def cell(self, arm: str, profile: str, experiment: str = "scenario-1") -> Cell:
        return self._cells[experiment, arm, profile]

    def on(self, profile: str) -> list[Cell]:
        return [cell for cell in self._cells.values() if cell.profile == profile]

    def both(self, arm: str, profile: str, column: str, experiment: str = "scenario-1") -> tuple[str, str]:
        """A column of MQTT-XT and of MAVLink."""
        pair = numbers_of(self.cell(arm, profile, experiment)).texts[column]
        assert isinstance(pair, TextPair)
        return pair.mqttxt, pair.mavlink

    def one(self, arm: str, profile: str, column: str, experiment: str = "scenario-1") -> str:
        """A column with one figure for both, without its sign."""
        return str(numbers_of(self.cell(arm, profile, experiment)).texts[column]).removesuffix("×").removeprefix("−")

    def attempts(self, protocol: str, arm: str, profile: str, experiment: str = "scenario-1") -> list[dict[str, Any]]:
        """All that count, failed ones too."""
        side: dict[str, Any] = self.cell(arm, profile, experiment).metrics["protocols"][protocol]
        return list(side["attempts"])

    def bytes_of(self, protocol: str, arm: str) -> Bytes:
        """Where a side's bytes are, in scenario 1 on `thesis`."""
        return next(one for one in bytes_of(self.cell(arm, "thesis")) if one.protocol == protocol)

    def commands_bytes(self, arm: str, profile: str) -> str:
        """MAVLink's bytes for commands over MQTT-XT's, as the table of claims has them."""
        return claims()[0].judge(self.cell(arm, profile)).figure.removesuffix("×")

    def purpose(self, protocol: str, arm: str, profile: str, name: str, unit: str) -> float:
        """The median of a purpose's packets or bytes over completed attempts, without what acknowledges them."""
        side = self.cell(arm, profile).metrics["protocols"][protocol]
        return median(one["purposes"][name][unit] for one in completed(side))


def lost_of(quantity: Share, attempts: Iterable[dict[str, Any]]) -> QuantityFigure:
    """What these attempts lost together, failed ones too."""
    return quantity.together([observe_attempt(one) for one in attempts])


def _none(lost: QuantityFigure) -> int | str:
    return (lost.loss.lost if lost.loss else 0) or "none"


def _known(lost: QuantityFigure) -> str:
    return f"{lost.loss.known:,}" if lost.loss else ""


def passages(found: Findings) -> Iterator[list[str]]:
    yield _traffic(found)
    yield _commands(found)
    yield _missions(found)
    yield _losses(found)
    yield _bundles(found)
    yield _lossy(found)
    yield _delays(found)
    yield _other_profiles(found)
    yield from _real_px4s(found)
    yield from _layers(found)
    yield _readings(found)
    yield from _message_set(found)
    yield from _targets(found)
    yield from _less_on_the_wire(found)


def _other_profiles(found: Findings) -> list[str]:
    """MAVLink's bytes over MQTT-XT's, least and most, and the most of its states that MAVLink lost."""
    rates = sorted((found.one(BUNDLED, profile, "rates") for profile in OTHER_PROFILES), key=float)
    lost = [lost_of(STATES_LOST, found.attempts("mavlink", BUNDLED, profile)) for profile in OTHER_PROFILES]
    most = max(lost, key=lambda one: one.value or 0.0)
    return [rates[0], f"{rates[-1]} times", most.text.partition(" of ")[0]]


def _traffic(found: Findings) -> list[str]:
    """MAVLink's bytes over MQTT-XT's: PX4's streams; five states by chains per drone; by one router per node."""
    chains = [found.cell(f"{arm}+chain-per-uav", "thesis") for arm in (FIVE, BUNDLED)]
    times = [found.one(arm, "thesis", "rates") for arm in (PX4, *(cell.arm for cell in chains))]
    upkeep = found.bytes_of("mavlink", chains[0].arm).purposes["upkeep"]
    pings = words.share(median(map(_pings, completed(chains[0].metrics["protocols"]["mavlink"]))))
    states = [claims()[1].judge(cell).figure.removesuffix("×") for cell in chains]
    shared = [found.one(arm, "thesis", "rates") for arm in (FIVE, BUNDLED)]
    return [*(f"{one} times" for one in times), words.share(upkeep), pings, *states, *shared]


def _pings(attempt: dict[str, Any]) -> float:
    """The share of MAVSDK's PINGs and the drones' answers among all bytes: each crosses the links of its chain."""
    sent = [*attempt["mavlink"]["commands"], *attempt["mavlink"]["streams"]]
    own = sum(one["bytes"] for one in sent if one["name"] in ("PING", "PING (answer)"))
    return LINKS_OF_A_CHAIN * own / sum(purpose["bytes"] for purpose in attempt["purposes"].values())


def _commands(found: Findings) -> list[str]:
    """Commands' frames and bytes of either side, results' bytes, and the ratios on `lte` and on `thesis`."""
    figures = []
    for side in SIDES:
        packets = found.purpose(side, BUNDLED, "lte", "command", "packets")
        figures += [f"{packets:g} frames", words.size(found.purpose(side, BUNDLED, "lte", "command", "bytes"))]
    figures += [words.size(found.purpose(side, BUNDLED, "lte", "result", "bytes")) for side in SIDES]
    judged = (claims()[0].judge(cell) for cell in found.on("thesis") if cell.experiment != "messages")
    ratios = (one.figure.removesuffix("×") for one in judged if one.holds is not None)
    return [*figures, found.commands_bytes(BUNDLED, "lte"), _span(ratios)]


def _missions(found: Findings) -> list[str]:
    """Mission times: on `thesis`, each scenario's change, how many MAVLink completed; on `lte`; all drones at once."""
    figures = ["scenario 1", *found.both(PX4, "thesis", "mission")]
    for number in _timed(found):
        figures += [f"scenario {number}"] if number > 1 else []
        figures.append(found.one(PX4, "thesis", "change", f"scenario-{number}"))
    figures += [_completed(found, PX4, f"scenario-{number}") for number in _timed(found)]
    figures += ["`lte`", *found.both(PX4, "lte", "mission")]
    return [*figures, *found.both(FIVE, "thesis", "mission"), "`thesis`"]


def _losses(found: Findings) -> list[str]:
    """MAVLink's states lost and missions failed with PX4's streams on `thesis`, and its loss with five states."""
    flown = [found.attempts("mavlink", arm, "thesis", experiment) for experiment, arm in STREAMED]
    shares = [lost_of(STATES_LOST, attempts) for attempts in flown]
    least, *_, most = sorted((share.brief for share in shares), key=_first)
    statuses = [one["status"] for attempts in flown for one in attempts]
    of_five = [cell.metrics["protocols"]["mavlink"]["attempts"] for cell in found.on("thesis") if FIVE in cell.arm]
    assert {one["status"] for attempts in of_five for one in attempts} == {"completed"}
    of_five_lost = sorted((lost_of(STATES_LOST, attempts).brief for attempts in of_five), key=_first)
    return [
        f"{least.removesuffix(' %')} to {most}",
        f"{statuses.count('failed')} of {len(statuses)} missions",
        f"{of_five_lost[0].removesuffix(' %')} to {of_five_lost[-1]}",
    ]


def _first(text: str) -> float:
    return float(text.split()[0])


def _bundles(found: Findings) -> list[str]:
    """A position's delay: in bundles, of single attempts, and at the latest; MAVLink's, and topic by topic."""
    profiles = ("ideal", "lte", "lossy", "thesis")
    bundled = [f"{_span_ms(_positions_ms(found, 'mqttxt', BUNDLED, profile))} on `{profile}`" for profile in profiles]
    of_bundles = [one for profile in profiles for one in found.attempts("mqttxt", BUNDLED, profile)]
    latest = words.milliseconds(max(one["state_delay_ms"]["location"]["captures"]["max"] for one in of_bundles))
    theirs = [_position_ms(found, "mavlink", BUNDLED, profile) for profile in profiles]
    alone = [f"{_position_ms(found, 'mqttxt', FIVE, profile)} on `{profile}`" for profile in profiles[:2]]
    return [*bundled, latest, *theirs, *alone]


def _position_ms(found: Findings, side: str, arm: str, profile: str) -> str:
    """The median of the completed attempts' medians."""
    return words.milliseconds(median(_positions_ms(found, side, arm, profile)))


def _positions_ms(found: Findings, side: str, arm: str, profile: str) -> list[float]:
    """Each completed attempt's median."""
    done = completed(found.cell(arm, profile).metrics["protocols"][side])
    return [one["state_delay_ms"]["location"]["captures"]["p50"] for one in done]


def _span_ms(values: Sequence[float]) -> str:
    """'119 to 450 ms'."""
    return f"{min(values):.0f} to {max(values):.0f} ms"


def _lossy(found: Findings) -> list[str]:
    """What either side loses on `lossy`, its longest state, and its median command: MAVLink's loss comes first."""
    ours, theirs = (lost_of(STATES_LOST, found.attempts(side, FIVE, "lossy")) for side in SIDES)
    longest = {
        side: max(
            delay["captures"]["max"] or 0.0
            for one in found.attempts(side, FIVE, "lossy")
            for delay in one["state_delay_ms"].values()
        )
        for side in SIDES
    }
    figures = [theirs.brief, f"{_none(ours)} of {_known(ours)}"]
    figures += [words.milliseconds(longest["mqttxt"]), f"{longest['mavlink']:.0f} ms"]
    return [*figures, *found.both(FIVE, "lossy", "delay")]


def _delays(found: Findings) -> list[str]:
    """The median command: MAVLink's and MQTT-XT's on `ideal`, MQTT-XT's and MAVLink's on `lte`."""
    ours, theirs = found.both(PX4, "ideal", "delay")
    return [theirs, ours, *found.both(PX4, "lte", "delay")]


def _real_px4s(found: Findings) -> Iterator[list[str]]:
    """Real PX4s beside the stand-ins: attempts; bytes over MQTT-XT's; bytes per second; missions."""
    real = {arm: f"{arm}+autopilot-px4" for arm in (BUNDLED, FIVE)}
    flown = [one for arm in real.values() for side in SIDES for one in found.attempts(side, arm, "ideal")]
    assert {one["status"] for one in flown} == {"completed"}
    completions = [found.cell(arm, "ideal").metrics["statistics"]["completion"] for arm in real.values()]
    void = sum(each[side]["void"] for each in completions for side in SIDES)
    yield [f"{len(flown)} missions", f"{void} more"]
    assert not any(lost_of(quantity, flown).loss.lost for quantity in (COMMANDS_LOST, STATES_LOST))
    yield [found.one(name, "ideal", "rates") for arm in real for name in (real[arm], arm)]
    ours, theirs = zip(*(found.both(name, "ideal", "rate") for name in (real[BUNDLED], BUNDLED)), strict=True)
    yield [*ours, *theirs]
    second = [found.both(name, "ideal", "mission", "scenario-2")[0] for name in (real[BUNDLED], BUNDLED)]
    apart = [
        abs(_mission_s(found, side, real[arm]) / _mission_s(found, side, arm) - 1) for side in SIDES for arm in real
    ]
    yield [*second, words.share(max(apart))]


def _mission_s(found: Findings, side: str, arm: str) -> float:
    """The median of completed missions on `ideal`."""
    return median(one["mission_s"] for one in completed(found.cell(arm, "ideal").metrics["protocols"][side]))


def _layers(found: Findings) -> Iterator[list[str]]:
    """MQTT-XT's payload, headers and acknowledgements; payload and bytes per second with bundles and without."""
    ours = found.bytes_of("mqttxt", PX4)
    headers = sum(ours.layers[name] for name in ("TCP or UDP", "IP", "Ethernet"))
    shares = [words.share(one) for one in (ours.layers["payload"], headers, ours.purposes["acknowledgement"])]
    alone, bundled = (found.bytes_of("mqttxt", arm) for arm in (FIVE, BUNDLED))
    payloads = [words.share(one.layers["payload"]) for one in (bundled, alone)]
    yield [*shares, *payloads, *(one.a_second for one in (bundled, alone))]


def _readings(found: Findings) -> list[str]:
    """How many values arrived, and after how long: in each arm MQTT-XT's, then MAVLink's."""
    delays = []
    for arm in (PX4, BUNDLED):
        for side in SIDES:
            done = completed(found.cell(arm, "thesis", "scenario-4").metrics["protocols"][side])
            assert all(series["delivered"] == 30 and not series["wrong"] for one in done for series in one["series"])
            assert all(len(one["series"]) == 18 for one in done)
            delays.append(words.milliseconds(median(one["reading_delay_ms"]["captures"]["p50"] for one in done)))
    return ["all 30 values", "18 series", *delays]


def _message_set(found: Findings) -> Iterator[list[str]]:
    """States' packets; commands' bytes; delays, calls and losses."""
    cell = found.cell(PX4, "thesis", "messages")
    rows = {str(row[0]): dict(zip(COLUMNS, row, strict=True)) for row in rows_of(cell)}
    sets = {side: found.attempts(side, PX4, "thesis", "messages")[0]["message_set"] for side in SIDES}
    commands, states = (
        [name for name, kind in sets["mqttxt"].items() if kind["form"] == form] for form in ("command", "state")
    )
    yield [_span(rows[name]["packets, all ×"] for name in states), str(rows["location"]["packets, alone ×"])]
    yield [_span(rows[name]["bytes, alone ×"] for name in commands)]
    calls = [sets["mavlink"][name] for name in commands]
    asked, received = (sum(kind[count] for kind in calls) for count in ("asked", "received"))
    first, last = (sets["mavlink"][name] for name in ("flight_mode", "groundspeed"))
    speeds = QuantityFigure.of_loss(Loss(last["lost"], last["sent"] - last["open"])).brief
    all_ = sum((Loss(kind["lost"], kind["sent"] - kind["open"]) for kind in sets["mqttxt"].values()), Loss(0, 0))
    delays = [getattr(rows["location"]["delay"], side) for side in SIDES]
    calls_lost = [f"{asked} calls", wording.in_words(asked - received)]
    yield [*delays, *calls_lost, str(first["lost"] or "none"), speeds, str(all_.lost or "none"), f"{all_.known:,}"]


def _span(ratios: Iterable[str | TextPair]) -> str:
    """'0.65 to 0.98'."""
    ordered = sorted((str(ratio) for ratio in ratios), key=float)
    return f"{ordered[0]} to {ordered[-1]}"


def _targets(found: Findings) -> Iterator[list[str]]:
    """The column of the table of targets, row by row, and the time of flight alone."""
    figures = []
    for profile in ("ideal", "thesis", "lte", "lossy"):
        figures += [*(found.one(PX4, profile, column) for column in ("packets", "bytes")), f"`{profile}`"]
    yield [*figures, f"{found.one(PX4, 'thesis', 'rates')} times"]
    bundled = [(found.one(BUNDLED, profile, "bytes"), f"`{profile}`") for profile in ("thesis", "lte", "lossy")]
    yield [text for pair in bundled for text in pair]
    shorter = {number: found.one(PX4, "thesis", "change", f"scenario-{number}") for number in _timed(found)}
    yield [text for number, share in shorter.items() for text in (f"−{share}", f"scenario {number}")]
    arms = ("thesis-concurrent", FIVE, BUNDLED)
    yield [text for arm in arms for text in (_ours_over_theirs(found, arm), f"`{arm}`")]
    commands = lost_of(COMMANDS_LOST, found.attempts("mqttxt", PX4, "thesis"))
    states = [(lost_of(STATES_LOST, found.attempts("mqttxt", arm, "thesis")), arm) for arm in (FIVE, BUNDLED)]
    yield [commands.counts, *(text for lost, arm in states for text in (lost.counts, f"`{arm}`"))]
    yield [text for arm in (PX4, FIVE, BUNDLED) for text in (found.one(arm, "lte", "delay ratio"), f"`{arm}`")]
    alone, _ = found.both("direct", "ideal", "mission")
    yield ["`direct`", f"scenario 1 takes {alone}"]


def _less_on_the_wire(found: Findings) -> Iterator[list[str]]:
    """The table's rows that rest on series that are kept."""
    lte = (_command_ratio(found, arm, "lte") for arm in (BUNDLED, f"{BUNDLED}+air-sn"))
    yield [f"{next(lte):.1f}", f"{next(lte):.2f}"]
    yield ["on `lossy`", f"{_command_ratio(found, BUNDLED, 'lossy'):.1f}"]
    lost = lost_of(STATES_LOST, found.attempts("mqttxt", f"{FIVE}+air-sn", "lossy"))
    longest = (_longest_ms(found, arm) for arm in (FIVE, f"{FIVE}+air-sn"))
    yield [lost.brief, *map(words.milliseconds, longest)]
    yield ["median command on `ideal`", *found.both(PX4, "ideal", "delay")]


def _command_ratio(found: Findings, arm: str, profile: str) -> float:
    ours, theirs = (_command_bytes(found, side, arm, profile) for side in SIDES)
    return ours / theirs


def _command_bytes(found: Findings, side: str, arm: str, profile: str) -> float:
    attempts = map(observe_attempt, completed(found.cell(arm, profile).metrics["protocols"][side]))
    return median(COMMAND_BYTES.of(one) or 0.0 for one in attempts)


def _longest_ms(found: Findings, arm: str) -> float:
    """Of the five states, which are published at a rate, over MQTT-XT on `lossy`."""
    delays = [one["state_delay_ms"] for one in found.attempts("mqttxt", arm, "lossy")]
    return max(each[name]["captures"]["max"] for each in delays for name in STATES)


def _timed(found: Findings) -> list[int]:
    """The scenarios of which MAVLink completed one on `thesis` with PX4's streams, asking one by one."""
    return [number for number in (1, 2, 3, 4) if _done(found, PX4, f"scenario-{number}")]


def _done(found: Findings, arm: str, experiment: str) -> int:
    """How many missions on `thesis` MAVLink completed."""
    return len(completed(found.cell(arm, "thesis", experiment).metrics["protocols"]["mavlink"]))


def _completed(found: Findings, arm: str, experiment: str) -> str:
    """The same of those that count, as in "two of 3"."""
    done, flown = _done(found, arm, experiment), found.attempts("mavlink", arm, "thesis", experiment)
    return f"{wording.in_words(done)} of {len(flown)}"


def _ours_over_theirs(found: Findings, arm: str) -> str:
    """MQTT-XT's mission time on `lossy` over MAVLink's."""
    return f"{1 / found.cell(arm, 'lossy').metrics['ratios']['mission']:.2f}"
