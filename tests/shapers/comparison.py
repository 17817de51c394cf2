"""The comparison: each flow's statistics over the kernel's links and the emulator's, and how close they have to be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median, pstdev, quantiles
from typing import Any

from .rounds import JITTERED, LARGE, WIDE, Flow, Round, topology
from .statistics import beyond, ks_distance, ks_limit, mean_limit, overtaken, share_limit

BEYOND = 1.5
LATE_MS = 0.25
"""The delay that a Python program adds in the virtual machine, where an instruction takes a nanosecond."""


SENDING_MS = 2.0
"""The time to send a burst: its frames do not begin to wait all at once."""


@dataclass(frozen=True)
class Row:
    """A statistic of both shapers; they agree if `difference` is at most `tolerance`."""

    feature: str
    statistic: str
    kernel: str
    emulator: str
    difference: float
    tolerance: float
    unit: str = ""

    @property
    def agrees(self) -> bool:
        return self.difference <= self.tolerance

    def __str__(self) -> str:
        return (
            f"{self.feature}: {self.statistic}: kernel {self.kernel}, emulator {self.emulator}: "
            f"{self.difference:.3g} apart, expected {self.tolerance:.3g} at most"
        )


class Came:
    """A flow's arrivals over one shaper's links."""

    def __init__(self, flow: Flow, data: Mapping[str, Any], counted: Mapping[str, Any] | None) -> None:
        self.flow = flow
        self.queue_drops, self.random_drops = (counted["queue"], counted["random"]) if counted else (0, 0)
        self.sent: int = data["sent"]
        self.rows = [tuple(row) for row in data["rows"]]
        self.sound = [(number, sent_us, came_us) for number, sent_us, came_us, sound in self.rows if sound]
        self.numbers = [number for number, _, _ in self.sound]
        self.delays_ms = [(came_us - sent_us) / 1000 for _, sent_us, came_us in self.sound]

    @property
    def missing(self) -> float:
        """The share of datagrams that did not arrive."""
        return 1 - len(set(self.numbers)) / self.sent

    @property
    def doubled(self) -> float:
        """The share of the arrived datagrams that arrived twice."""
        counted = Counter(self.numbers)
        return sum(count == 2 for count in counted.values()) / len(counted)

    @property
    def overtaken(self) -> float:
        return overtaken(self.numbers) / len(self.numbers)

    def rate_bps(self) -> float:
        times = [came_us for _, _, came_us in self.sound]
        return (len(times) - 1) * self.flow.size * 8 / (times[-1] - times[0]) * 1e6

    def bits_between(self, from_us: int, until_us: int) -> int:
        return sum(from_us < came_us <= until_us for _, _, came_us in self.sound) * self.flow.size * 8


Pair = tuple[Came, Came]
"""The kernel's arrivals and the emulator's."""
Compare = Callable[[str, Mapping[str, Pair]], Iterator[Row]]


def compare(chosen: Sequence[Round], kernel: Mapping[str, Any], emulator: Mapping[str, Any]) -> dict[str, list[Row]]:
    """The rows of every feature, from both machines' results."""
    came: dict[str, Pair] = {}
    for each, one, other in zip(chosen, kernel["rounds"], emulator["rounds"], strict=True):
        for flow, by_kernel, by_emulator in zip(each.flows, one["flows"], other["flows"], strict=True):
            link = topology().link_of(flow.source, flow.destination)
            came[flow.name] = (
                Came(flow, by_kernel, one["counters"]["links"].get(link)),
                Came(flow, by_emulator, other["counters"]["links"].get(link)),
            )
    return {name: list(_compare(name)(name, came)) for name in features(chosen) if name in came}


def features(chosen: Sequence[Round]) -> list[str]:
    """The names of the compared flows, without those that only accompany another."""
    return [flow.name for each in chosen for flow in each.flows if flow.name not in ACCOMPANY]


def _compare(name: str) -> Compare:
    return COMPARED.get(name, _profile)


def _close(feature: str, statistic: str, pair: tuple[float, float], tolerance: float, unit: str = "ms") -> Row:
    one, other = (f"{value:.4g} {unit}".strip() for value in pair)
    return Row(feature, statistic, one, other, abs(pair[0] - pair[1]), tolerance, unit)


def _share(feature: str, statistic: str, shares: tuple[float, float], sizes: tuple[int, int], spread: float = 1) -> Row:
    """A row of two shares; `spread`: how many times wider than independent draws they spread."""
    pooled = (shares[0] * sizes[0] + shares[1] * sizes[1]) / sum(sizes)
    limit = share_limit(pooled, *sizes) * spread
    return _close(feature, statistic, (100 * shares[0], 100 * shares[1]), 100 * limit, "%")


def _lost(name: str, pair: Pair) -> Row:
    return _share(name, "frames lost", (pair[0].missing, pair[1].missing), (pair[0].sent, pair[1].sent))


def _ks(name: str, pair: Pair, late_ms: float = LATE_MS) -> Row:
    one, other = pair[0].delays_ms, pair[1].delays_ms
    words = [f"{fmean(values):.1f} ± {pstdev(values):.1f} ms" for values in (one, other)]
    distance, limit = ks_distance(one, other, late_ms), ks_limit(len(one), len(other))
    return Row(name, "delays, KS distance", words[0], words[1], distance, limit)


def _mean(name: str, pair: Pair, late_ms: float = LATE_MS) -> Row:
    deviation = max(pstdev(came.delays_ms) for came in pair)
    limit = mean_limit(deviation, len(pair[0].numbers), len(pair[1].numbers)) + late_ms
    return _close(name, "delay, mean", (fmean(pair[0].delays_ms), fmean(pair[1].delays_ms)), limit)


def _queue_drops(name: str, pair: Pair) -> Row:
    shares = [100 * each.queue_drops / each.sent for each in pair]
    return _close(name, "dropped by the queue, counted", (shares[0], shares[1]), 1.0, "%")


def _median(name: str, pair: Pair, tolerance_ms: float) -> Row:
    return _close(name, "delay, median", (median(pair[0].delays_ms), median(pair[1].delays_ms)), tolerance_ms)


def _rate(name: str, pair: Pair, tolerance: float) -> Row:
    kbit = (pair[0].rate_bps() / 1000, pair[1].rate_bps() / 1000)
    return _close(name, "rate", kbit, tolerance * kbit[0], "kbit/s")


def _overtaken(name: str, pair: Pair, spread: float) -> Row:
    """Whether a frame is overtaken depends on its neighbours, so shares spread wider than of independent frames."""
    return _share(name, "overtaken", (pair[0].overtaken, pair[1].overtaken), (pair[0].sent, pair[1].sent), spread)


def _constant(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    yield _median(name, pair, LATE_MS)
    spreads = [(cuts := quantiles(each.delays_ms, n=20))[-1] - cuts[0] for each in pair]
    yield _close(name, "delay, 5 % to 95 %", (spreads[0], spreads[1]), LATE_MS)


def _beyond(name: str, pair: Pair, jitter: Mapping[str, int]) -> Row:
    shares = [beyond(each.delays_ms, BEYOND * jitter["jitter_us"] / 1000) for each in pair]
    sizes = len(pair[0].delays_ms), len(pair[1].delays_ms)
    return _share(name, f"beyond {BEYOND} jitters", (shares[0], shares[1]), sizes)


def _jitter(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    yield _ks(name, pair)
    yield _beyond(name, pair, JITTERED)
    yield _mean(name, pair)
    yield _close(name, "overtaken", (100 * pair[0].overtaken, 100 * pair[1].overtaken), 0, "%")


def _reordering(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    yield _ks(name, came[name])
    yield _beyond(name, came[name], WIDE)
    yield _overtaken(name, came[name], 1.5)


def _loss(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    yield _lost(name, came[name])


def _duplicate(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    sizes = len(set(pair[0].numbers)), len(set(pair[1].numbers))
    yield _share(name, "frames that came twice", (pair[0].doubled, pair[1].doubled), sizes)
    yield _lost(name, pair)
    yield _median(name, pair, LATE_MS)


def _reorder(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    shares = [sum(delay < 15 for delay in each.delays_ms) / each.sent for each in pair]
    yield _share(name, "frames without delay", (shares[0], shares[1]), (pair[0].sent, pair[1].sent))
    yield _overtaken(name, pair, 2)


def _all(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    yield _ks(name, pair)
    yield _lost(name, pair)
    sizes = len(set(pair[0].numbers)), len(set(pair[1].numbers))
    yield _share(name, "frames that came twice", (pair[0].doubled, pair[1].doubled), sizes)
    yield _overtaken(name, pair, 2)


def _overload(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    """A full queue's delay is known to within a frame: half a frame of difference counts as none."""
    pair = came[name]
    yield _rate(name, pair, 0.005)
    yield _queue_drops(name, pair)
    yield _median(name, pair, pair[0].flow.size * 8 / 1000 / 2 + LATE_MS)


def _burst(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    yield _close(name, "frames through of 60", (len(pair[0].numbers), len(pair[1].numbers)), 0, "")
    yield _close(name, "delay of the last", (max(pair[0].delays_ms), max(pair[1].delays_ms)), SENDING_MS)


def _rate_and_loss(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    """Lost frames have used the rate."""
    pair = came[name]
    yield _rate(name, pair, share_limit(0.2, *(len(each.numbers) for each in pair)) / 0.8)
    yield _queue_drops(name, pair)
    shares = [each.random_drops / (each.sent - each.queue_drops) for each in pair]
    sizes = [each.sent - each.queue_drops for each in pair]
    yield _share(name, "lost at random, counted", (shares[0], shares[1]), (sizes[0], sizes[1]))


def _distribution(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    yield _ks(name, came[name])
    yield _mean(name, came[name])


def _outage(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    lost = [each.sent - len(each.numbers) for each in pair]
    yield _close(name, "frames lost", (lost[0], lost[1]), EVENT_FRAMES, "")


def _slower(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    pair = came[name]
    lost = [each.sent - len(each.numbers) for each in pair]
    yield _close(name, "frames lost", (lost[0], lost[1]), EVENT_FRAMES, "")
    yield _close(name, "delay, greatest", (max(pair[0].delays_ms), max(pair[1].delays_ms)), LARGE // 2 * 8 / 100)


def _later(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    late = [sum(delay > 50 for delay in each.delays_ms) for each in came[name]]
    yield _close(name, "frames delayed", (late[0], late[1]), EVENT_FRAMES, "")


def _shared(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    """Compare rates while the queues are full."""
    ups, downs = ([each.bits_between(3_000_000, 19_000_000) / 16_000 for each in came[one]] for one in SHARING[name])
    yield _close(name, "rate, both ways", (ups[0] + downs[0], ups[1] + downs[1]), 0.02 * 64, "kbit/s")
    yield _close(name, "rate up", (ups[0], ups[1]), 0.05 * 64, "kbit/s")


def _quiet(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    """The kernel sends its first full frame ahead of time, so that its links differ by half a frame in the mean."""
    pair = came[name]
    yield _ks(name, pair)
    yield _mean(name, pair, 1000 * 8 / 64 / 2)


def _profile(name: str, came: Mapping[str, Pair]) -> Iterator[Row]:
    """Compare delays and losses over three links."""
    yield _ks(name, came[name], 3 * LATE_MS)
    yield _mean(name, came[name], 3 * LATE_MS)
    yield _lost(name, came[name])


EVENT_FRAMES = 2
"""By how many frames, 10 ms or more apart, the two instants of an event may differ."""
SHARING = {
    "shared, equal frames": ("shared, equal frames", "equal down"),
    "shared, large and small": ("shared, large and small", "small down"),
}
ACCOMPANY = ("equal down", "small down", "full up")
COMPARED: Mapping[str, Compare] = {
    "delay": _constant,
    **{f"jitter {kind}": _jitter for kind in ("normal", "uniform", "pareto")},
    **{f"reordering jitter {kind}": _reordering for kind in ("normal", "uniform", "pareto")},
    "loss": _loss,
    "duplicate": _duplicate,
    "corrupt": _loss,
    "reorder": _reorder,
    "loss and duplicate": _duplicate,
    "all at once": _all,
    "overload": _overload,
    "burst": _burst,
    "rate and loss": _rate_and_loss,
    "rate and duplicate": _duplicate,
    "slow": _constant,
    "rate and jitter": _distribution,
    **dict.fromkeys(SHARING, _shared),
    "shared, quiet way": _quiet,
    "closed": _outage,
    "slower": _slower,
    "later": _later,
}
