"""A kernel that remembers what `ip` and `tc` told it, and shows it in the words of iproute2 6.15 on Linux 6.12."""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from typing import Any

from net.shaping.commands import Done

SHARES = {"loss": "loss-random", "duplicate": "duplicate", "corrupt": "corrupt", "reorder": "reorder"}
NOTHING = {"bytes": 0, "packets": 0, "drops": 0, "overlimits": 0, "requeues": 0, "backlog": 0, "qlen": 0}


class FakeTc:
    """`refuses` are words that a command fails for; `counted` numbers of a netem, by device and handle."""

    def __init__(self, refuses: str = "") -> None:
        self.refuses = refuses
        self.said: list[str] = []
        """Every line that told it something."""
        self.qdiscs: dict[tuple[str, str], dict[str, Any]] = {}
        self.classes: dict[tuple[str, str], dict[str, Any]] = {}
        self.filters: dict[tuple[str, str], list[dict[str, Any]]] = {}
        self.devices: dict[str, int] = {}
        """By name the frames that each dropped."""

    def __call__(self, words: Sequence[str], text: str | None = None) -> Done:
        if "-batch" not in words:
            return self._run(list(words), 1)
        out = ""
        for number, line in enumerate((text or "").splitlines(), 1):
            done = self._run([words[0], *line.split()], number)
            out += done.out
            if done.code:
                return Done(1, out, f"{done.err} Command failed -:{number}")
        return Done(0, out, "")

    def count(self, device: str, handle: str = "1:", **numbers: int) -> None:
        """Let a netem have counted that much."""
        self.qdiscs[device, handle].update(numbers)

    def pass_by(self, out: str, mark: str, packets: int) -> None:
        """Let so many frames have come to the second stage of the link with that number."""
        for each in self.filters[out, "egress"]:
            if each["options"]["fw"]["mark"] == mark:
                each["options"]["actions"][0]["stats"]["packets"] = packets

    def _run(self, words: list[str], _: int) -> Done:
        line = " ".join(words)
        if self.refuses and self.refuses in line:
            return Done(2, "", "Error: Specified qdisc kind is unknown.")
        if "show" in words:
            return Done(0, json.dumps(self._shown(words)), "")
        self.said.append(line)
        if words[:3] == ["ip", "link", "add"]:
            self.devices[words[3]] = 0
        if words[0] == "tc" and words[2] != "del":
            {"qdisc": self._qdisc, "class": self._class, "filter": self._filter}[words[1]](words)
        return Done(0, "", "")

    def _shown(self, words: list[str]) -> list[dict[str, Any]]:
        if words[0] == "ip":
            return [
                {"ifname": name, "stats64": {"rx": {"dropped": lost}, "tx": {"dropped": 0}}}
                for name, lost in self.devices.items()
            ]
        device = words[words.index("dev") + 1] if "dev" in words else None
        if words[1] == "filter":
            return [{"protocol": "ip", "pref": 1, "kind": "fw", "chain": 0}, *self.filters.get((device, words[-1]), [])]
        shown = self.qdiscs if words[1] == "qdisc" else self.classes
        return [
            content if device is None else {name: value for name, value in content.items() if name != "dev"}
            for (place, _), content in shown.items()
            if device in (None, place)
        ]

    def _qdisc(self, words: list[str]) -> None:
        device = _after("dev", words)
        if words[-1] == "clsact":
            self.qdiscs[device, "ffff:"] = {"kind": "clsact", "handle": "ffff:", "dev": device, "parent": "ffff:fff1"}
            return
        handle = _after("handle", words)
        content = self.qdiscs.setdefault((device, handle), {**NOTHING, "handle": handle, "dev": device})
        content |= {"parent": _after("parent", words)} if "parent" in words else {"root": True}
        if "netem" not in words:
            content |= {"kind": "htb", "options": {"r2q": 10}}
            return
        told = words[words.index("netem") + 1 :]
        options: dict[str, Any] = {"limit": int(_after("limit", told)), "ecn": False, "gap": 0}
        if "delay" in told:
            times = [float(word[:-2]) / 1e6 for word in told[told.index("delay") + 1 :][:2] if word.endswith("us")]
            options["delay"] = {"delay": times[0], "jitter": (*times, 0)[1], "correlation": 0}
        for word, key in SHARES.items():
            if word in told and (share := float(_after(word, told)[:-1]) / 100):
                options[key] = {word: float(f"{share:.6g}"), "correlation": 0}
        if "rate" in told:
            options["rate"] = {"rate": int(_after("rate", told)[:-3]) // 8, "packetoverhead": 0}
        if "seed" in told:
            options["seed"] = int(_after("seed", told))
        content |= {"kind": "netem", "options": options}

    def _class(self, words: list[str]) -> None:
        told = words[words.index("htb") :]
        rates = {name: int(_after(name, told)[:-3]) // 8 for name in ("rate", "ceil")}
        parent = {} if _after("parent", words) == "1:" else {"parent": _after("parent", words)}
        name = _after("classid", words)
        self.classes[_after("dev", words), name] = {"class": "htb", "handle": name, **parent, **rates}

    def _filter(self, words: list[str]) -> None:
        actions = []
        if "skbedit" in words:
            priority = {"priority": _after("priority", words)} if "priority" in words else {}
            actions.append({"kind": "skbedit", **priority, "mark": int(_after("mark", words)), "stats": dict(NOTHING)})
        if "redirect" in words:
            actions.append({"kind": "mirred", "to_dev": words[-1], "stats": dict(NOTHING)})
        options: dict[str, Any] = {"actions": actions}
        if "u32" in words:
            value = socket.inet_aton(_after("dst", words)[:-3]).hex()
            options["match"] = {"value": value, "mask": "ffffffff", "offmask": "", "off": 16}
        else:
            options["fw"] = {"mark": hex(int(_after("handle", words))), "mask": "0xffffffff"}
        self.filters.setdefault((_after("dev", words), words[5]), []).append({"kind": "u32", "options": options})


def _after(word: str, words: Sequence[str]) -> str:
    return words[list(words).index(word) + 1]
