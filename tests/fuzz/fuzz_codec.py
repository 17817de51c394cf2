"""Coverage-guided fuzzing of what takes bytes from the wire: `python tests/fuzz/fuzz_codec.py FOLDER -runs=N`.

The first byte chooses the message; the rest is its payload, or (from the upper half of the bytes) says what values a
CBOR payload is made of. Nothing but PayloadError may come out; what is decoded must come back equal from both forms.
The corpus is made in FOLDER: the specification's worked examples, and every message with its least and most values.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import atheris
import cbor2

with atheris.instrument_imports(include=["mqttxt"]):
    from mqttxt.errors import PayloadError
    from mqttxt.protocol.codec import decode, encode, layout_of
    from mqttxt.protocol.fields import Binary, Constant, Finite, Integer, Items, Name, Named, Real, Scaled, Text
    from mqttxt.protocol.identify import identify
    from mqttxt.protocol.state_payload import decode_state, encode_state, message_class
    from mqttxt.protocol.states import STATES
    from mqttxt.protocol.topics import CloudSide, FogSide
    from mqttxt.protocol.values import Encoding
    from spec.examples import examples
    from spec.schema import MESSAGES

STATE_NAMES = sorted(STATES)
TARGETS: list[Any] = [*MESSAGES, *((name, relayed) for name in STATE_NAMES for relayed in (False, True))]


def decoded(target: Any, payload: bytes) -> tuple[Any, list[bytes]]:
    """What a payload says as `target`, and that in both forms."""
    if isinstance(target, tuple):
        state = decode_state(target[0], payload, relayed=target[1])
        return state, [encode_state(state, encoding) for encoding in Encoding]
    found = decode(target, payload)
    return found, [encode(found, encoding) for encoding in Encoding]


def plain(provider: Any, depth: int = 0) -> Any:
    """Any value that CBOR has and a payload may be made of; mostly arrays at the top."""
    kind = provider.ConsumeIntInRange(0, 7) if depth else 7
    if kind == 7 and depth < 4:
        return [plain(provider, depth + 1) for _ in range(provider.ConsumeIntInRange(0, 14))]
    if kind in (0, 1):
        return provider.ConsumeIntInRange(0, 260)
    if kind == 2:
        return provider.ConsumeInt(9)
    if kind == 3:
        return provider.ConsumeBool()
    if kind == 4:
        return provider.ConsumeRegularFloat()
    return provider.ConsumeUnicodeNoSurrogates(8) if kind == 5 else None


def check(data: bytes) -> None:
    """One input."""
    if not data:
        return
    target, payload = TARGETS[data[0] % 128 % len(TARGETS)], data[1:]
    if data[0] >= 128:
        payload = cbor2.dumps(plain(atheris.FuzzedDataProvider(payload)))
    identify(payload)
    for side in (FogSide(), CloudSide(1)):
        try:
            side.parse(payload.decode(errors="replace"))
        except PayloadError:
            continue
    try:
        found, forms = decoded(target, payload)
    except PayloadError:
        return
    for form in forms:
        again, _ = decoded(target, form)
        if again != found:
            raise AssertionError(f"{target}: {found} came back as {again}")


def value(mark: Any, most: bool) -> Any:
    """The least or the most that a field carries."""
    if isinstance(mark, Integer):
        return mark.high if most else mark.low
    if isinstance(mark, Scaled):
        return mark.high if most else mark.low
    if isinstance(mark, Real | Finite):
        return 3.0e38 if most else -3.0e38
    if isinstance(mark, Constant):
        return mark.value
    if isinstance(mark, Text):
        return "x" * mark.longest if most else "x" if isinstance(mark, Name) else ""
    if isinstance(mark, Binary):
        return b"\xff" * (mark.most if most else mark.least)
    if isinstance(mark, Items):
        return (value(mark.of, most),) * max(1, mark.least)
    if mark is bool:
        return most
    if issubclass(mark, Named):
        return list(mark)[-1 if most else 0]
    return message(mark, most)


def message(cls: Any, most: bool, variant_code: int | None = None) -> Any:
    """A message of a class with the least or the most in every field.

    Where a class does not take that, one of the fields that may be missing is left out, or one of those that name
    something, as a type that the value has to have, is at the other end, or only the last one is there.
    """
    layout = layout_of(cls)
    fields = {field.name: None if field.optional and not most else value(field.mark, most) for field in layout.fields}
    if layout.variant is not None:
        name, variant = layout.variant
        bodies = {code: body for code, _, body in variant.codes}
        fields[name] = message(bodies[variant_code or min(bodies)], most)
    changes: list[dict[str, Any]] = [{}, *({field.name: None} for field in layout.fields if field.optional)]
    named = [field for field in layout.fields if isinstance(field.mark, type) and issubclass(field.mark, Named)]
    changes += [{field.name: value(field.mark, not most)} for field in named]
    for change in changes:
        try:
            return cls(**{**fields, **change})
        except PayloadError:
            continue
    return cls(**{**fields, **{field.name: value(field.mark, False) for field in layout.fields[-1:]}})


def ends(cls: Any) -> Iterator[bytes]:
    """Both ends of a message, with each of its variants, in both forms."""
    layout = layout_of(cls)
    codes = [code for code, _, _ in layout.variant[1].codes] if layout.variant is not None else [None]
    for code in codes:
        for most in (False, True):
            for encoding in Encoding:
                yield encode(message(cls, most, code), encoding)


def write_corpus(folder: Path) -> None:
    """What every message may look like, in both forms, behind its number."""
    for number, target in enumerate(TARGETS):
        cls = message_class(*target) if isinstance(target, tuple) else target
        for index, payload in enumerate([*ends(cls), *(form for e in examples() for form in (e.cbor, e.json))]):
            try:
                decode(cls, payload)
            except PayloadError:
                continue
            (folder / f"{number}-{index}").write_bytes(bytes([number]) + payload)


def main(folder: Path, *options: str) -> None:
    corpus, words = folder / "corpus", folder / "words"
    corpus.mkdir(parents=True, exist_ok=True)
    write_corpus(corpus)
    names = {name for example in examples() for name in json.loads(example.json)}
    words.write_text("".join(f'"{name}"\n' for name in sorted(names)))
    atheris.Setup([sys.argv[0], f"-dict={words}", f"-artifact_prefix={folder}/", *options, str(corpus)], check)
    atheris.Fuzz()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
