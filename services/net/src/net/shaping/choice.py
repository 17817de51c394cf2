"""The choice of the shaper: netem if the kernel really has all that is needed, else the emulator; none if the plan
shapes nothing."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ..interfaces import NetError
from .commands import Runner, Words, run
from .run_plan import RunPlan

ONE, OTHER = "net-try-1", "net-try-2"
DEVICES: tuple[Words, ...] = tuple(
    ["ip", "link", *words] for name in (ONE, OTHER) for words in (["add", name, "type", "ifb"], ["set", name, "up"])
)
STAGES: tuple[Words, ...] = tuple(
    ["tc", *words.split()]
    for words in (
        f"qdisc add dev {ONE} root handle 1: htb",
        f"class add dev {ONE} parent 1: classid 1:1 htb rate 1000000bit burst 4000 ceil 1000000bit cburst 4000",
        f"qdisc add dev {ONE} parent 1:1 handle 201: netem limit 10 rate 1000000bit",
        f"qdisc add dev {ONE} clsact",
        f"filter add dev {ONE} ingress protocol ip prio 1 u32 match ip dst 198.18.0.1/32"
        f" action skbedit priority 1:1 mark 1 pipe action mirred egress redirect dev {OTHER}",
        f"filter add dev {ONE} egress protocol ip prio 1 handle 1 fw action mirred egress redirect dev {OTHER}",
        f"qdisc add dev {OTHER} root handle 1: netem limit 100 delay 10000us 1000us distribution normal reorder 1%"
        " loss 1% duplicate 1% corrupt 1% rate 10000000000bit seed 1",
    )
)


@dataclass(frozen=True)
class ShaperChoice:
    """The chosen `shaper`, netem, nfqueue or none, and why."""

    shaper: str
    why: str

    def to_data(self) -> dict[str, Any]:
        """The entries in shaper.json."""
        return asdict(self)


def choose(wanted: RunPlan, runner: Runner = run) -> ShaperChoice:
    """Choose the shaper of a run's links. Raises NetError if the plan asks for netem and the kernel cannot."""
    if not wanted.is_shaped:
        return ShaperChoice("none", f"profile {wanted.plan.profile} shapes nothing")
    if wanted.shaper == "nfqueue":
        return ShaperChoice("nfqueue", "the plan asks for it")
    refused = try_netem(runner)
    if refused is None:
        return ShaperChoice("netem", "the kernel has it" if wanted.shaper == "auto" else "the plan asks for it")
    if wanted.shaper == "netem":
        raise NetError(f"plan.json: shaper 'netem': {refused}; expected a kernel that can, or auto")
    return ShaperChoice("nfqueue", f"the kernel cannot shape by itself: {refused}")


def try_netem(runner: Runner = run) -> str | None:
    """Try both stages on two devices of their own; returns what the kernel refused, None if nothing."""
    try:
        for words in (*DEVICES, *STAGES):
            done = runner(words, None)
            if done.code:
                return f"{' '.join(words[:9])}: {done.err or f'exit code {done.code}'}"
        return None
    finally:
        for name in (ONE, OTHER):
            runner(["ip", "link", "del", name], None)
