"""The clauses of docs/results.md that tell a figure, each made from the series of docs/findings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from statistics import median
from typing import Any

from testbed.numbers import words
from testbed.numbers.observed import Loss, observe_attempt
from testbed.numbers.quantities import COMMANDS_LOST, STATES_LOST
from testbed.numbers.quantity import Figure, Share
from testbed.plan import wording
from testbed.present.report.comparison import completed
from testbed.present.summary.cells import SIDES, Cell
from testbed.present.summary.claims import claims
from testbed.present.summary.kinds import HEADINGS, rows_of
from testbed.present.summary.numbers import Pair, numbers_of
from testbed.present.summary.traffic import Bytes, bytes_of

PX4 = "thesis"
"""The arm in which PX4 streams its onboard set and drones are asked one by one."""
FIVE, BUNDLED = "five-states", "five-states-bundled"
STREAMED = (
    *(("scenario-1", arm) for arm in (PX4, "thesis-concurrent", "direct")),
    *((f"scenario-{number}", PX4) for number in (2, 3, 4)),
)
"""Where PX4's onboard streams are flown on the links of `thesis`."""
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
        assert isinstance(pair, Pair)
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


def lost_of(quantity: Share, attempts: Iterable[dict[str, Any]]) -> Figure:
    """What these attempts lost together, failed ones too."""
    return quantity.together([observe_attempt(one) for one in attempts])


def _none(lost: Figure) -> int | str:
    return (lost.loss.lost if lost.loss else 0) or "none"


def _known(lost: Figure) -> str:
    return f"{lost.loss.known:,}" if lost.loss else ""


def said(found: Findings) -> Iterator[str]:
    yield from _traffic(found)
    yield from _commands(found)
    yield from _missions(found)
    yield from _losses(found)
    yield from _delays(found)
    yield from _real_px4s(found)
    yield from _layers(found)
    yield from _readings(found)
    yield from _message_set(found)
    yield from _targets(found)


def _traffic(found: Findings) -> Iterator[str]:
    streamed = found.one(PX4, "thesis", "rates")
    yield f"On the profile `thesis` MAVLink sends {streamed} times the bytes a second of MQTT-XT where PX4 streams"
    chains = [found.cell(f"{arm}+chain-per-uav", "thesis") for arm in (FIVE, BUNDLED)]
    alone, bundled = (found.one(cell.arm, "thesis", "rates") for cell in chains)
    yield f"it sends {alone} times as many if MQTT-XT publishes topic by topic, and {bundled} times with its bundles"
    upkeep = found.bytes_of("mavlink", chains[0].arm).purposes["upkeep"]
    yield f"{words.share(upkeep)} of that is heartbeats and upkeep of its routers"
    alone, bundled = (claims()[1].judge(cell).figure.removesuffix("×") for cell in chains)
    yield f"its states alone need {alone} of MQTT-XT's bytes, or {bundled} times those of the bundles"
    alone, bundled = (found.one(arm, "thesis", "rates") for arm in (FIVE, BUNDLED))
    yield f"that makes it {alone} and {bundled} times"


def _commands(found: Findings) -> Iterator[str]:
    told = {
        (side, name): words.size(found.purpose(side, BUNDLED, "lte", name, "bytes"))
        for side in SIDES
        for name in ("command", "result")
    }
    frames = {side: f"{found.purpose(side, BUNDLED, 'lte', 'command', 'packets'):g} frames" for side in SIDES}
    yield f"in `{BUNDLED}` on `lte` {frames['mqttxt']} and {told['mqttxt', 'command']} a mission"
    yield f"against {frames['mavlink']} and {told['mavlink', 'command']}"
    yield f"{told['mqttxt', 'result']} against the {told['mavlink', 'result']} of MAVLink's acknowledgements"
    yield f"as on `lte`, MAVLink needs {found.commands_bytes(BUNDLED, 'lte')} of MQTT-XT's bytes for commands"
    judged = (claims()[0].judge(cell) for cell in found.on("thesis") if cell.experiment != "messages")
    ratios = (one.figure.removesuffix("×") for one in judged if one.holds is not None)
    yield f"every command goes out three times, and it needs {_span(ratios)} of them, by scenario and arm"


def _missions(found: Findings) -> Iterator[str]:
    for number in _timed(found):
        ours, theirs = found.both(PX4, "thesis", "mission", f"scenario-{number}")
        shorter = found.one(PX4, "thesis", "change", f"scenario-{number}")
        yield f"scenario {number} takes {ours} instead of {theirs}, {shorter} less"
    of_three = (_completed(found, PX4, f"scenario-{number}") for number in _timed(found))
    yield f"of the missions that it completed, {wording.listed([f'{done} of 3' for done in of_three])}"
    for profile in ("lte", "lossy"):
        ours, theirs = found.both(PX4, profile, "mission")
        yield f"{ours} instead of {theirs} on `{profile}`"
    for profile in ("thesis", "lte"):
        yield " and ".join(found.both(FIVE, profile, "mission")) + f" on `{profile}`"
    yield " and ".join(found.both(PX4, "ideal", "mission")) + " on `ideal`"


def _losses(found: Findings) -> Iterator[str]:
    flown = [found.attempts("mavlink", arm, "thesis", experiment) for experiment, arm in STREAMED]
    shares = [lost_of(STATES_LOST, attempts) for attempts in flown]
    least, *_, most = sorted((share.brief for share in shares), key=lambda text: float(text.split()[0]))
    yield f"{least.removesuffix(' %')} to {most} of MAVLink's states are lost"
    statuses = [one["status"] for attempts in flown for one in attempts]
    failed = statuses.count("failed")
    yield f"so that {failed} of {len(statuses)} missions end with a call that nobody answered in time"
    of_five = lost_of(STATES_LOST, found.attempts("mavlink", FIVE, "thesis"))
    yield f"there MAVLink loses {of_five.brief}, and completes every mission"
    ours, theirs = (lost_of(STATES_LOST, found.attempts(side, FIVE, "lossy")) for side in SIDES)
    yield f"in `{FIVE}`, MAVLink loses {theirs.brief} of its states and MQTT-XT {_none(ours)} of {_known(ours)}"
    longest = {
        side: max(
            delay["captures"]["max"] or 0.0
            for one in found.attempts(side, FIVE, "lossy")
            for delay in one["state_delay_ms"].values()
        )
        for side in SIDES
    }
    yield f"a state that TCP sends again comes up to {words.milliseconds(longest['mqttxt'])} after it left the drone"
    yield f"none of MAVLink's takes longer than {longest['mavlink']:.0f}"
    ours, theirs = found.both(FIVE, "lossy", "delay")
    yield f"The median command takes {ours} there, MAVLink's {theirs.removesuffix(' ms')}"


def _delays(found: Findings) -> Iterator[str]:
    ours, theirs = found.both(PX4, "ideal", "delay")
    yield f"On `ideal` one is at its drone in {theirs}, MQTT-XT's in {ours}"
    ours, theirs = found.both(PX4, "lte", "delay")
    yield f"on `lte` {ours} against {theirs.removesuffix(' ms')}"


def _real_px4s(found: Findings) -> Iterator[str]:
    real = {arm: f"{arm}+autopilot-px4" for arm in (BUNDLED, FIVE)}
    flown = [one for arm in real.values() for side in SIDES for one in found.attempts(side, arm, "ideal")]
    assert {one["status"] for one in flown} == {"completed"}
    completions = [found.cell(arm, "ideal").metrics["statistics"]["completion"] for arm in real.values()]
    void = sum(each[side]["void"] for each in completions for side in SIDES)
    yield f"None of {len(flown)} missions that count failed; {void} more were void"
    rates = [found.one(name, "ideal", "rates") for arm in real for name in (real[arm], arm)]
    yield f"MAVLink sends {rates[0]} times the bytes a second of MQTT-XT, where the stand-in's series has {rates[1]}"
    yield f"in `{FIVE}` {rates[2]} times, where it has {rates[3]}"
    assert not any(lost_of(quantity, flown).loss.lost for quantity in (COMMANDS_LOST, STATES_LOST))
    ours, theirs = zip(*(found.both(name, "ideal", "rate") for name in (real[BUNDLED], BUNDLED)), strict=True)
    yield f"{ours[0]} a second in `{BUNDLED}` instead of {ours[1]}. MAVLink sends {theirs[0]} instead of {theirs[1]}"
    times = [" and ".join(found.both(name, "ideal", "mission")) for arm in real for name in (real[arm], arm)]
    yield f"{times[0]} in `{BUNDLED}` instead of {times[1]}, {times[2]} in `{FIVE}` instead of {times[3]}"
    second = [found.both(name, "ideal", "mission", "scenario-2")[0] for name in (real[BUNDLED], BUNDLED)]
    yield f"scenario 2 over MQTT-XT takes {second[0]} instead of {second[1]}"
    apart = [
        abs(_mission_s(found, side, real[arm]) / _mission_s(found, side, arm) - 1) for side in SIDES for arm in real
    ]
    yield f"The missions of scenario 1 differ by {words.share(max(apart))} at most"


def _mission_s(found: Findings, side: str, arm: str) -> float:
    """The median of completed missions on `ideal`."""
    return median(one["mission_s"] for one in completed(found.cell(arm, "ideal").metrics["protocols"][side]))


def _layers(found: Findings) -> Iterator[str]:
    ours = found.bytes_of("mqttxt", PX4)
    headers = sum(ours.layers[name] for name in ("TCP or UDP", "IP", "Ethernet"))
    yield f"Of MQTT-XT's bytes in the arm `{PX4}` {words.share(ours.layers['payload'])} is what it has to say"
    yield f"Headers of TCP, IP and Ethernet are {words.share(headers)}"
    yield f"and {words.share(ours.purposes['acknowledgement'])} of all are acknowledgements"
    alone, bundled = (found.bytes_of("mqttxt", arm) for arm in (FIVE, BUNDLED))
    payloads = [words.share(one.layers["payload"]) for one in (bundled, alone)]
    rates = [one.a_second for one in (bundled, alone)]
    yield f"{' instead of '.join(payloads)} payload, and {' instead of '.join(rates)} a second"


def _readings(found: Findings) -> Iterator[str]:
    delays = {}
    for arm in (PX4, BUNDLED):
        for side in SIDES:
            done = completed(found.cell(arm, "thesis", "scenario-4").metrics["protocols"][side])
            assert all(series["delivered"] == 30 and not series["wrong"] for one in done for series in one["series"])
            assert all(len(one["series"]) == 18 for one in done)
            delays[arm, side] = words.milliseconds(median(one["reading_delay_ms"]["captures"]["p50"] for one in done))
    yield "In every completed attempt all 30 values of the 18 series arrived, and arrived as they were measured"
    yield f"after {delays[PX4, 'mqttxt']} over MQTT-XT and {delays[PX4, 'mavlink']} through the brokers beside MAVLink"
    yield f"{delays[BUNDLED, 'mqttxt']} and {delays[BUNDLED, 'mavlink']} in `{BUNDLED}`"


def _message_set(found: Findings) -> Iterator[str]:
    cell = found.cell(PX4, "thesis", "messages")
    rows = {str(row[0]): dict(zip(COLUMNS, row, strict=True)) for row in rows_of(cell)}
    sets = {side: found.attempts(side, PX4, "thesis", "messages")[0]["message_set"] for side in SIDES}
    commands, states = (
        [name for name, kind in sets["mqttxt"].items() if kind["form"] == form] for form in ("command", "state")
    )
    yield f"so the ratio is {_span(rows[name]['packets, all ×'] for name in states)} instead of 16 to 23"
    yield f"location is {rows['location']['packets, alone ×']} times"
    yield f"Commands alone cost MAVLink {_span(rows[name]['bytes, alone ×'] for name in commands)} of MQTT-XT's bytes"
    ours, theirs = (getattr(rows["location"]["delay"], side) for side in SIDES)
    yield f"A position takes {ours} over MQTT-XT and {theirs.removesuffix(' ms')} over MAVLink"
    calls = [sets["mavlink"][name] for name in commands]
    asked, received = (sum(kind[count] for kind in calls) for count in ("asked", "received"))
    yield f"Of MAVLink's {asked} calls {wording.in_words(asked - received)} were not acknowledged"
    first, last = (sets["mavlink"][name] for name in ("flight_mode", "groundspeed"))
    speeds = Figure.of_loss(Loss(last["lost"], last["sent"] - last["open"])).brief
    yield f"{first['lost'] or 'none'} of its flight modes, first in each burst, and {speeds} of its ground speeds"
    all_ = sum((Loss(kind["lost"], kind["sent"] - kind["open"]) for kind in sets["mqttxt"].values()), Loss(0, 0))
    yield f"Of MQTT-XT's {all_.known:,} messages {all_.lost or 'none'} was lost"


def _span(ratios: Iterable[str | Pair]) -> str:
    """'0.65 to 0.98'."""
    told = sorted((str(ratio) for ratio in ratios), key=float)
    return f"{told[0]} to {told[-1]}"


def _targets(found: Findings) -> Iterator[str]:
    times = {
        profile: [found.one(PX4, profile, column) for column in ("packets", "bytes")]
        for profile in ("ideal", "thesis", "lte", "lossy")
    }
    ratios = ", ".join(f"{packets} and {size} on `{profile}`" for profile, (packets, size) in times.items())
    yield f"| {ratios}; {found.one(PX4, 'thesis', 'rates')} times the bytes a second on `thesis` |"
    bundled = ", ".join(
        f"{found.one(BUNDLED, profile, 'bytes')} on `{profile}`" for profile in ("thesis", "lte", "lossy")
    )
    yield f"| {bundled} |"
    shorter = {number: found.one(PX4, "thesis", "change", f"scenario-{number}") for number in _timed(found)}
    yield f"| {', '.join(f'−{share} in scenario {number}' for number, share in shorter.items())} |"
    concurrent = ("thesis-concurrent", FIVE, BUNDLED)
    yield "| " + ", ".join(f"{_ours_over_theirs(found, arm)} in `{arm}`" for arm in concurrent) + " |"
    commands = lost_of(COMMANDS_LOST, found.attempts("mqttxt", PX4, "thesis"))
    states = (lost_of(STATES_LOST, found.attempts("mqttxt", arm, "thesis")) for arm in (FIVE, BUNDLED))
    told = ", ".join(f"{one.counts} in `{arm}`" for arm, one in zip((FIVE, BUNDLED), states, strict=True))
    yield f"| {commands.counts}; {told} |"
    delays = ", ".join(f"{found.one(arm, 'lte', 'delay ratio')} in `{arm}`" for arm in (PX4, FIVE, BUNDLED))
    yield f"| {delays} |"
    alone, _ = found.both(PX4, "ideal", "mission")
    yield f"Scenario 1 takes {alone} of flight and holding"


def _timed(found: Findings) -> list[int]:
    """The scenarios of which MAVLink completed one on `thesis` with PX4's streams, asking one by one."""
    return [number for number in (1, 2, 3, 4) if _completed(found, PX4, f"scenario-{number}") != "none"]


def _completed(found: Findings, arm: str, experiment: str = "scenario-1") -> str:
    """How many of MAVLink's missions on `thesis`, in a word."""
    done = len(completed(found.cell(arm, "thesis", experiment).metrics["protocols"]["mavlink"]))
    return wording.in_words(done) if done else "none"


def _ours_over_theirs(found: Findings, arm: str) -> str:
    """MQTT-XT's mission time on `lossy` over MAVLink's."""
    return f"{1 / found.cell(arm, 'lossy').metrics['ratios']['mission']:.2f}"
