"""COSE_Sign1 as messages are signed: both ways with another library, and nothing else is read."""

from __future__ import annotations

from typing import Any

import cbor2
import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from pycose.algorithms import EdDSA
from pycose.headers import KID, Algorithm
from pycose.keys import OKPKey
from pycose.keys.curves import Ed25519
from pycose.messages import Sign1Message

from mqttxt.errors import PayloadError
from mqttxt.protocol.names import MAX_DRONE
from mqttxt.security.cose import MOST_CERTIFICATE_BYTES, PROTECTED, ROUTE, Envelope, external_aad
from mqttxt.security.identity import KEY_FILE, Identity, read_key
from mqttxt.security.rights import Rights
from tests.simulation.signing import folder, seal

TOPIC, SIGNER = "drone1/clock", "drone1"


def aad() -> bytes:
    authority_key = seal(SIGNER).identity.fleet.key_hash
    return cbor2.dumps(["mqttxt1", authority_key, SIGNER, TOPIC])


def their_key() -> OKPKey:
    key = read_key(folder(SIGNER, Rights(), "acme") / KEY_FILE)
    private = key.private_bytes(Encoding.Raw, PrivateFormat.Raw, NoEncryption())
    public = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    return OKPKey(crv=Ed25519, d=private, x=public)


def test_another_library_verifies_what_is_signed() -> None:
    message = Sign1Message.from_cose_obj(cbor2.loads(seal(SIGNER).sign(TOPIC, b"payload").encode()), True)
    message.key, message.external_aad = their_key(), aad()
    assert message.verify_signature()
    assert message.payload == b"payload"
    message.external_aad = external_aad(b"\0" * 32, SIGNER, TOPIC)
    assert not message.verify_signature()


def test_what_another_library_signs_is_verified() -> None:
    kid = seal(SIGNER).certificate.hash[:4]
    message = Sign1Message(phdr={Algorithm: EdDSA}, uhdr={KID: kid}, payload=b"payload", external_aad=aad())
    message.key = their_key()
    signed = seal(SIGNER).open(TOPIC, message.encode(tag=False), SIGNER)
    assert (signed.payload, signed.signer) == (b"payload", SIGNER)


def test_an_envelope_has_its_bytes_and_comes_back() -> None:
    envelope = seal(SIGNER).sign(TOPIC, b"x", with_certificate=True).routed([5, True])
    data = envelope.encode()
    assert data.startswith(b"\x84\x43\xa1\x01\x27\xa3\x04\x44")
    assert Envelope.parse(data) == envelope
    assert len(envelope.bare().routed(None).encode()) == 1 + 4 + 1 + 1 + 5 + 2 + 66


def parts(**changed: Any) -> bytes:
    found = {"protected": PROTECTED, "header": {4: b"\0" * 4}, "payload": b"x", "signature": b"\0" * 64, **changed}
    return cbor2.dumps(list(found.values()))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        b"{}",
        cbor2.dumps([1, 2, 3]),
        cbor2.dumps(cbor2.CBORTag(18, cbor2.loads(parts()))),
        parts(protected=cbor2.dumps({1: -7})),
        parts(protected=b""),
        parts(header={}),
        parts(header={4: b"\0" * 5}),
        parts(header={4: b"\0" * 4, 1: -8}),
        parts(header=[4]),
        parts(header={4: b"\0" * 4, 5: b""}).replace(b"\x05\x40", b"\x04\x40"),
        parts(header={4: b"", 5: b"\0" * 4}).replace(b"\x05\x44", b"\x04\x44"),
        parts(header={4: b"\0" * 4, 33: "text"}),
        parts(header={4: b"\0" * 4, 33: b"\0" * 2049}),
        parts(payload=None),
        parts(signature=b"\0" * 63),
        parts() + b"\0",
        parts(payload=b"\0" * 70_000),
    ],
)
def test_anything_else_is_not_read(data: bytes) -> None:
    with pytest.raises(PayloadError):
        Envelope.parse(data)


def test_the_longest_certificate_of_a_station_is_short_enough() -> None:
    every_other = frozenset(range(1, MAX_DRONE, 2))
    rights = Rights(every_other, take_over=True, observe=True, upload_plan=True, set_parameters=True)
    certificate = Identity.load(folder(f"gs-{'x' * 61}", rights, "f" * 64)).certificate
    assert 1000 < len(certificate.der) <= MOST_CERTIFICATE_BYTES


def test_the_route_is_not_signed() -> None:
    data = seal(SIGNER).sign(TOPIC, b"x").routed(77).encode()
    assert seal(SIGNER).open_one_of(data, {SIGNER: TOPIC}).envelope.route == 77
    assert cbor2.loads(data)[1][ROUTE] == 77
