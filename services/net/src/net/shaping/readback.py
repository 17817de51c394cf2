"""Compares the commands given to the kernel with what it reports: qdiscs, classes and filters, field by field.

In the JSON of `tc` (iproute2 6.15) rates are bytes per second, times seconds, shares fractions, all rounded to six
digits. A netem's distribution is not shown, its seed only by kernels that have one (6.6).
"""

from __future__ import annotations

import math
import socket
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..interfaces import NetError
from .commands import Runner, Words, carry_out

ROUNDED = 1e-5
_SHARES = {"loss": "loss-random", "duplicate": "duplicate", "corrupt": "corrupt", "reorder": "reorder"}
"""netem's options, with the JSON objects that hold them."""
_FLAT = ("limit", "seed")
Key = tuple[str, ...]
"""The kind of an object, its device, and its name there."""
Fields = Mapping[str, float | str]


def read_back(asked: Sequence[Words], runner: Runner) -> dict[str, int]:
    """Count the qdiscs, classes and filters that exist as requested. Raises NetError that names a difference."""
    wanted = {place: _asked(words) for place, words in enumerate(asked) if words[0] == "tc"}
    places = list(dict.fromkeys(key[:-1] for key, _ in wanted.values()))
    shows = [["tc", key[0], "show", "dev", *key[1:]] for key in places]
    there: dict[Key, Fields] = {}
    for key, content in zip(places, carry_out(shows, runner, "show"), strict=True):
        for item in content:
            there |= {(*key, name): fields for name, fields in _shown(key[0], item)}
    for place, (key, fields) in wanted.items():
        where = f"kernel.begin[{place}]: {' '.join(key)}"
        if key not in there:
            raise NetError(f"{where}: not there; expected it as asked")
        for name, value in fields.items():
            found = there[key].get(name, 0.0)
            if not _same(found, value) and not (name == "seed" and name not in there[key]):
                raise NetError(f"{where}: {name} {found}; expected {value}")
    return dict(Counter(f"{key[0]}{'s' if key[0] != 'class' else 'es'}" for key, _ in wanted.values()))


def _same(found: float | str, wanted: float | str) -> bool:
    if isinstance(found, str) or isinstance(wanted, str):
        return found == wanted
    return math.isclose(found, wanted, rel_tol=ROUNDED, abs_tol=1e-9)


def _asked(words: Words) -> tuple[Key, Fields]:
    """The key of the object that a `tc ... add` makes, and its fields."""
    kind, device = words[1], _after("dev", words)
    if kind == "filter":
        return _asked_filter(words, device)
    if kind == "class":
        told = words[words.index("htb") :]  # the device may be called rate, too
        rates = {name: _bits(_after(name, told)) // 8 for name in ("rate", "ceil")}
        return ("class", device, _after("classid", words)), {"parent": _after("parent", words), **rates}
    if words[-1] == "clsact":
        return ("qdisc", device, "ffff:"), {"kind": "clsact"}
    fields: dict[str, float | str] = {"kind": "htb"}
    if "netem" in words:
        fields = {"kind": "netem", **_netem(words[words.index("netem") + 1 :])}
    if "parent" in words:
        fields["parent"] = _after("parent", words)
    return ("qdisc", device, _after("handle", words)), fields


def _asked_filter(words: Words, device: str) -> tuple[Key, Fields]:
    side = words[5]
    fields: dict[str, float | str] = {}
    if "skbedit" in words:
        fields["mark"] = float(_after("mark", words))
    if "priority" in words:
        fields["priority"] = _after("priority", words)
    if "redirect" in words:
        fields["to"] = words[-1]
    if "u32" in words:
        address = _after("dst", words).removesuffix("/32")
        return ("filter", device, side, socket.inet_aton(address).hex()), fields
    return ("filter", device, side, hex(int(_after("handle", words)))), fields


def _netem(words: Words) -> dict[str, float]:
    fields: dict[str, float] = {"delay": 0.0, "jitter": 0.0, "rate": 0.0, **dict.fromkeys(_SHARES, 0.0)}
    for place, word in enumerate(words):
        following = words[place + 1] if place + 1 < len(words) else ""
        if word in _FLAT:
            fields[word] = float(following)
        elif word == "rate":
            fields[word] = _bits(following) // 8
        elif word in _SHARES:
            fields[word] = float(following.removesuffix("%")) / 100
        elif word == "delay":
            fields[word] = _seconds(following)
            beyond = words[place + 2] if place + 2 < len(words) else ""
            fields["jitter"] = _seconds(beyond) if beyond.endswith("us") else 0.0
    return fields


def _shown(kind: str, item: Mapping[str, Any]) -> Iterator[tuple[str, Fields]]:
    """The name and fields of one object in the output of `tc -j ... show`; nothing for an object around others."""
    options = item.get("options", {})
    if kind == "class":
        parent = {"parent": item.get("parent", "1:")}
        yield item["handle"], {**parent, "rate": float(item["rate"]), "ceil": float(item["ceil"])}
    elif kind == "qdisc":
        fields: dict[str, float | str] = {"kind": item["kind"], "parent": item.get("parent", "")}
        if item["kind"] == "netem":
            fields |= {name: float(options[name]) for name in _FLAT if name in options}
            fields |= {name: float(options.get("delay", {}).get(name, 0.0)) for name in ("delay", "jitter")}
            fields |= {word: float(options.get(key, {}).get(word, 0.0)) for word, key in _SHARES.items()}
            fields["rate"] = float(options.get("rate", {}).get("rate", 0.0))
        yield item["handle"], fields
    elif "actions" in options:
        found: dict[str, float | str] = {}
        for action in options["actions"]:
            found |= {name: action[name] for name in ("mark", "priority") if name in action}
            found |= {"to": action["to_dev"]} if "to_dev" in action else {}
        yield options["match"]["value"] if "match" in options else options["fw"]["mark"], found


def _after(word: str, words: Words) -> str:
    return words[list(words).index(word) + 1]


def _bits(text: str) -> int:
    return int(text.removesuffix("bit"))


def _seconds(text: str) -> float:
    return int(text.removesuffix("us")) / 1_000_000
