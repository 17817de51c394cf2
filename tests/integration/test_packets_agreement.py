"""The packets table against tshark and pymavlink, on captures of a real broker, real clients and a real autopilot."""

from __future__ import annotations

import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import paho.mqtt.client as paho
import polars as pl
import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from pymavlink.dialects.v20 import development as dialect

from testbed.fly.results import Attempt, write_json
from testbed.numbers.packets.table import load
from tests.e2e.agreement import Nodes, assert_pymavlink_agrees, assert_tshark_agrees, count_by_tshark, kind_of
from tests.rigs.processes import ROOT, Process, Program, as_this_user, listens, wait_until
from tests.rigs.tcpdump import Tcpdump
from tests.tools.node_programs import MOSQUITTO

pytestmark = pytest.mark.integration

NETWORK = f"127.{secrets.randbelow(250) + 2}.{secrets.randbelow(256)}"
"""Of loopback, this process's own: captures hold all that comes and goes there."""
ADDRESSES = {name: f"{NETWORK}.{last}" for last, name in enumerate(("gs", "cloud", "fog1", "uav1"), 32)}
LINKS = (("wan:gs", "gs", "cloud"), ("backhaul:fog1", "fog1", "cloud"), ("air:uav1", "uav1", "fog1"))
PORT, DISCARD = 1883, 9
LAST = b"the last datagram of a capture"


@contextmanager
def capturing(attempt: Attempt) -> Iterator[None]:
    """Everything between the nodes' addresses, in whole frames, as the capture of every node."""
    pcap = attempt.path / "pcap"
    wanted = " or ".join(f"host {address}" for address in ADDRESSES.values())
    # The largest frame of loopback, and room for a thousand of them: in immediate mode each takes as much.
    sizes = ["-s", "66000", "-B", "65536"]
    with Tcpdump(pcap / "all", wanted, "--time-stamp-precision=nano", *sizes) as tcpdump:
        # What all of loopback sent until the filter was there may have filled the buffer: that counts as dropped.
        tcpdump.count()
        yield
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind((ADDRESSES["gs"], 0))
            sock.sendto(LAST, (ADDRESSES["cloud"], DISCARD))
        # At SIGINT tcpdump leaves what it has not taken.
        wait_until(lambda: LAST in (pcap / "all").read_bytes(), "tcpdump has taken all that came before")
        tcpdump.end()
        before, after = tcpdump.dropped()
        assert after == before
    for node in ADDRESSES:
        shutil.copy(pcap / "all", pcap / f"{node}.pcap")
    (pcap / "all").unlink()


@pytest.fixture
def attempt(tmp_path: Path) -> Attempt:
    found = Attempt(tmp_path / "attempt-01", "mqttxt", 1)
    (found.path / "pcap").mkdir(parents=True)
    nodes = [{"name": name, "address": address} for name, address in ADDRESSES.items()]
    links = [{"name": name, "lower": lower, "upper": upper} for name, lower, upper in LINKS]
    words = {"experiment": "scenario-1", "arm": "thesis", "profile": "ideal", "status": "completed", "shaper": "none"}
    objects: dict[str, object] = {"revision": {}, "configuration": {}, "host": {}, "versions": {}}
    about = {"version": 1, "protocol": "mqttxt", "reason": None, "topology": {"nodes": nodes, "links": links}}
    write_json(found.path / "manifest.json", words | objects | about)
    return found


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[str]:
    """The address of a real Mosquitto on MQTT's own port, at the cloud's address."""
    host = ADDRESSES["cloud"]
    configuration = tmp_path / "broker.conf"
    configuration.write_text(f"{as_this_user()}persistence false\nlistener {PORT} {host}\nallow_anonymous true\n")
    program = Program(tmp_path, "broker", str(MOSQUITTO), "-c", str(configuration)).start()
    try:
        wait_until(lambda: listens(PORT, host), "the broker listens")
        yield host
    finally:
        program.kill()


def _client(name: str, address: str, received: list[bytes]) -> paho.Client:
    client = paho.Client(paho.CallbackAPIVersion.VERSION2, name, protocol=paho.MQTTv5)
    client.on_message = lambda *words: received.append(words[2].payload)
    client.connect(address, PORT, bind_address=ADDRESSES[name])
    client.loop_start()
    wait_until(client.is_connected, f"{name} is connected")
    return client


def test_tshark_counts_the_frames_bytes_and_publishes_of_mqtt(attempt: Attempt, broker: str) -> None:
    received: list[bytes] = []
    bodies = [b"", b"x", b"y" * 200, b"z" * 100_000]
    with capturing(attempt):
        listener, talker = _client("gs", broker, received), _client("fog1", broker, [])
        acknowledged: list[int] = []
        listener.on_subscribe = lambda *words: acknowledged.append(words[2])
        listener.subscribe("#", qos=2)
        wait_until(lambda: bool(acknowledged), "subscribed")
        alias = Properties(PacketTypes.PUBLISH)
        alias.TopicAlias = 1
        talker.publish("fog1/drone1/state/battery", b"first", properties=alias)
        for qos in (0, 1, 2):
            for body in bodies:
                talker.publish("fog1/drone1/state/location", body, qos=qos)
        for _ in range(30):  # in one segment, as many as fit
            talker.publish("", b"again", properties=alias)
        wait_until(lambda: len(received) == 31 + 3 * len(bodies), "all is received")
        for client in (talker, listener):
            client.disconnect()
            client.loop_stop()
    assert_tshark_agrees(attempt)
    found = load(attempt).messages
    kinds = found["kind"].cast(pl.String).value_counts()
    counted = dict(kinds.iter_rows())
    assert counted["publish"] == 2 * (31 + 3 * len(bodies))
    assert counted["puback"] == 2 * len(bodies)
    assert found.filter(pl.col("topic") == "fog1/drone1/state/battery").height == 2 * 31
    assert load(attempt).frames["left_ns"].null_count() == 0


def test_pymavlink_counts_the_messages_of_a_real_autopilot(attempt: Attempt, tmp_path: Path) -> None:
    station = dialect.MAVLink(None, srcSystem=245, srcComponent=190)
    heard = dialect.MAVLink(None)
    names: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock, capturing(attempt):
        sock.bind((ADDRESSES["fog1"], 14541))
        sock.settimeout(10)
        ends = ["--listen", f"{ADDRESSES['uav1']}:14580", "--send", f"{ADDRESSES['fog1']}:14541"]
        fleet = ["--fleet", str(ROOT / "services" / "fleet.yaml"), "--system", "1"]
        more = ["--streams", "px4-onboard", "--ready-file", str(tmp_path / "sitl.ready")]
        sitl = Process(tmp_path, "sitl", "sitl", "fly", *fleet, *ends, *more).start()
        try:
            sitl.wait_ready()
            while names.count("ATTITUDE") < 200 or "COMMAND_ACK" not in names:
                if names.count("ATTITUDE") == 50:
                    arm = dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
                    first, second = (arm.pack(station, force_mavlink1=old) for old in (False, True))
                    sock.sendto(first + second, (ADDRESSES["uav1"], 14580))
                for message in heard.parse_buffer(sock.recv(65_536)) or ():
                    names.append(kind_of(message))
        finally:
            sitl.kill()
    assert_pymavlink_agrees(attempt)
    assert_tshark_agrees(attempt)
    found = load(attempt).messages
    counted = dict(found["kind"].cast(pl.String).value_counts().iter_rows())
    assert all(counted[name] >= names.count(name) for name in set(names))  # more came after the last that was read
    sent = found.filter(pl.col("link").cast(pl.String) == "air:uav1:down")
    assert set(sent["kind"].cast(pl.String)) == {"COMMAND_LONG"}
    assert set(sent["version"]) == {1, 2}


def test_a_capture_that_the_table_does_not_have_all_of_is_noticed(attempt: Attempt, broker: str) -> None:
    with capturing(attempt):
        talker = _client("fog1", broker, [])
        done = talker.publish("a", b"1", qos=1)
        wait_until(done.is_published, "acknowledged")
        talker.disconnect()
        talker.loop_stop()
    told = count_by_tshark(attempt.path / "pcap" / "fog1.pcap", Nodes.of(attempt))
    assert (told.publishes, told.entered > 3, told.frames > told.entered) == (1, True, True)
    frames = attempt.path / "packets.parquet"
    assert_tshark_agrees(attempt)
    table = pl.read_parquet(frames)
    table.head(len(table) - 1).write_parquet(frames, metadata=pl.read_parquet_metadata(frames))
    with pytest.raises(AssertionError):
        assert_tshark_agrees(attempt)
