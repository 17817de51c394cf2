"""The CPU of six stand-ins in flight at PX4's onboard rates, their traffic, and whether they keep the rates."""

from __future__ import annotations

import time
from collections import Counter

from sitl.px4.streams import rates_hz
from tests.bench.brokers import cpu_s
from tests.bench.fit_streams import Streams, flying

DRONES = 6
STREAMS = "px4-onboard"
WINDOW_S = 10.0
STEADY_HZ = 5
"""Slower streams have too few messages in the window to be judged."""
ETHERNET_BYTES = 14


def measure() -> list[str]:
    """One line of figures; takes about 20 s."""
    with flying(STREAMS, DRONES) as stand_ins:
        stand_ins.listen(0)  # until all fly
        before = time.monotonic(), cpu_s(*stand_ins.pids)
        sent = stand_ins.listen(WINDOW_S)
        wall_s, used_s = time.monotonic() - before[0], cpu_s(*stand_ins.pids) - before[1]
    frames = [frame for stream in sent.values() for frame in stream]
    kbit_s = sum(frame.size - ETHERNET_BYTES for frame in frames) * 8 / 1000 / WINDOW_S / DRONES
    return [
        f"sitl: {DRONES} drones climbing at onboard rates take {100 * used_s / wall_s:.1f} % of one core; "
        f"each sends {len(frames) / WINDOW_S / DRONES:.0f} messages/s, {kbit_s:.0f} kbit/s with UDP/IP; "
        f"a stream of {STEADY_HZ} Hz or more is off PX4's rate by {100 * _worst(sent):.1f} % at most"
    ]


def _worst(sent: Streams) -> float:
    """The largest deviation of a drone's stream from its rate, as a part of it."""
    counted = [Counter(frame.kind for frame in stream) for stream in sent.values()]
    steady = {name: hz for name, hz in rates_hz(STREAMS).items() if hz >= STEADY_HZ}
    return max(abs(found[name] / WINDOW_S / hz - 1) for found in counted for name, hz in steady.items())
