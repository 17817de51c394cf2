"""Netlink messages as the kernel reads and writes them."""

from __future__ import annotations

import struct

from net.emulator import nfqueue
from net.emulator.nfqueue import attribute, payload_of, read_drops, verdict_prefix, verdict_with

ID = bytes.fromhex("00000102")


def test_a_verdict_is_a_prefix_and_the_packets_id() -> None:
    # struct nlmsghdr, struct nfgenmsg, struct nlattr, struct nfqnl_msg_verdict_hdr
    head = struct.pack("=IHHII", 32, 0x301, 1, 0, 0) + bytes.fromhex("00000007")
    assert verdict_prefix(7, True) + ID == head + struct.pack("=HH", 12, 2) + bytes.fromhex("00000001") + ID
    assert verdict_prefix(7, False) + ID == head + struct.pack("=HH", 12, 2) + bytes.fromhex("00000000") + ID


def test_a_verdict_may_have_another_content() -> None:
    made = verdict_with(300, ID, b"abcde")
    assert struct.unpack_from("=I", made)[0] == len(made) == 32 + 12
    assert made[18:20] == (300).to_bytes(2, "big")
    assert made[-12:] == struct.pack("=HH", 9, 10) + b"abcde\0\0\0"


def test_the_copied_bytes_are_found_among_the_attributes() -> None:
    packet = (
        attribute(1, ID + bytes.fromhex("08000200")) + attribute(5, bytes(4)) + attribute(10, b"\x45\x00\x00\x05abc")
    )
    data = nfqueue.message(nfqueue.PACKET, 0, 3, packet)
    assert payload_of(data) == b"\x45\x00\x00\x05abc"
    assert data[nfqueue.ID_AT : nfqueue.ID_AT + nfqueue.ID_BYTES] == ID
    assert payload_of(nfqueue.message(nfqueue.PACKET, 0, 3, attribute(1, ID))) == b""
    assert payload_of(data[:22]) == b""


def test_the_kernels_drops_are_those_of_full_queues_and_of_a_full_socket() -> None:
    text = "    0  1417     0 2     4     3     2       29  1\n    1  1417     0 2     4     0     0       11  1\n"
    assert read_drops(text) == {0: 5, 1: 0}
