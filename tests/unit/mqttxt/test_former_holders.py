"""Who is obeyed once another activator leads the drone, and what a former holder leaves behind (R5.4, R6.8, R6.10)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mqttxt.activator.drones import CLOUD, CONTEST_MS, FOG
from mqttxt.core.effects import Inbound, Publish
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Hold, SetCurrentItem, SetParameter
from mqttxt.protocol.control import Control, Registration
from mqttxt.protocol.messages import Presence, Word
from tests.simulation.signing import seal
from tests.simulation.workbench import REPOSITION, Bench, said
from tests.simulation.world import (
    FOG_SESSION,
    GS_SESSION,
    UAV_SESSION,
    World,
    command_payload,
    heartbeat,
    landed,
    position,
)
from tests.unit.mqttxt.test_mission_starts import HASH, PX4_HOLD, Planned
from tests.unit.mqttxt.test_uav_client import hear, lease, words
from tests.unit.mqttxt.test_write_permit import ANOTHER, HERE, REFUSED, controlled, flying, kinds, pass_on, sent, value

OLD, NEW = 9, 10
"""Sessions of two activators; the new one has no records, and begins with epoch 0."""
THIRD = 8


def led(uav: Any, now_ms: int, holder: int | None, counter: int, activator: int = NEW, epoch: int = 0) -> None:
    until_ms = None if holder is None else 60_000
    lease(
        uav,
        now_ms,
        activator_session=activator,
        epoch=epoch,
        holder_session=holder,
        deadline_ms=until_ms,
        counter=counter,
    )


@pytest.mark.parametrize("was", ["holder", "holder before another one", "commander"])
def test_who_an_earlier_activator_led_is_not_obeyed_though_the_new_one_first_names_nobody(was: str) -> None:
    """As it does until a station has registered. The command stood in a connection."""
    uav = flying()
    if was == "commander":
        lease(uav, 1010, holder_session=None, counter=2)
        assert words(hear(uav, command_payload(HERE, deadline_ms=1000), 1020)) == [(Word.EXPIRED, None)]
    else:
        led(uav, 1010, GS_SESSION, 2, OLD, epoch=5)
    if was == "holder before another one":
        led(uav, 1020, THIRD, 3, OLD, epoch=6)
    led(uav, 1100, None, 1)
    led(uav, 1110, ANOTHER, 2)
    assert words(hear(uav, command_payload(HERE, seq=2, epoch=5), 1200)) == REFUSED
    assert kinds(hear(uav, command_payload(Hold(), gs_session=THIRD + 1, epoch=1), 1300)) == [REPOSITION], "a new one"
    led(uav, 1400, GS_SESSION, 3, epoch=2)
    led(uav, 1500, ANOTHER, 4, epoch=3)
    assert kinds(hear(uav, command_payload(HERE, seq=3, epoch=4), 1600)) == [REPOSITION], "named, and took it again"


def test_a_command_that_an_activator_without_records_has_not_sent_is_not_executed_for_its_epoch() -> None:
    """Both brokers and the activator were started anew; the drone's connection gives back what stood in it."""
    world = World().start(1000)
    register(world, "y", ANOTHER, Control.TAKE)
    world.run("gs", world.gs.take_over(1, (1,), world.now_ms))
    world.pass_time(1000)
    world.autopilot(heartbeat(armed=True), position(20.0), landed(2))
    subscribed = world.subscribed
    world.subscribed = [one for one in subscribed if one[:3] != ("uav", FOG, "drone1/commands")]
    world.send(HERE, ttl_ms=30_000)
    world.subscribed = subscribed
    (late,) = [one for name, one in world.sent if name == "activator" and one.topic == "drone1/commands"]
    world.deafen("gs")
    world.retained = {key: one for key, one in world.retained.items() if key[0] == FOG}
    world.restart_activator(FOG_SESSION + 1)
    world.pass_time(2000)
    register(world, "y", ANOTHER)
    assert world.uav.executor.lease.holder_session == ANOTHER
    world.run("uav", world.uav.on_message(FOG, Inbound(late.topic, late.payload, 1), world.now_ms))
    assert world.wrote == []


def register(world: World, name: str, session: int, control: Control = Control.WANT) -> None:
    wanted = Registration(name=name, session=session, nonce=7, lease_s=30, control=control, epoch=0)
    world.run(
        "activator", world.activator.on_message(CLOUD, Inbound("fog1/init_connect", encode(wanted), 1), world.now_ms)
    )


class Cut(World):
    """A fog whose activator has lost the cloud's broker, so that another one has taken its place."""

    def begin(self) -> Cut:
        self.start(1000)
        cut = self.activator
        self.cut, will = cut, cut.will()
        self.lose_subscriptions("activator", CLOUD)
        self.run("activator", cut.on_disconnected(CLOUD, self.now_ms))
        super().route("activator", Publish(CLOUD, will.topic, will.payload, 1, retain=True))
        self.other = self._activator(FOG_SESSION + 1)
        for link in (FOG, CLOUD):
            self.run("other", self.other.on_connected(link, self.now_ms))
        return self

    def pass_time(self, milliseconds: int, step_ms: int = 100) -> None:
        until = self.now_ms + milliseconds
        while self.now_ms < until:
            super().pass_time(min(step_ms, until - self.now_ms), step_ms)
            if hasattr(self, "other"):
                self.run("other", self.other.tick(self.now_ms))

    def route(self, name: str, publish: Publish) -> None:
        if name != "activator" or publish.link == FOG or not hasattr(self, "cut"):
            super().route(name, publish)


@pytest.mark.parametrize("signed", [False, True])
def test_an_activator_that_has_lost_the_cloud_ends_no_control_that_another_one_has_given(signed: bool) -> None:
    world = Cut(signed=signed).begin()
    world.pass_time(12_000)
    assert world.other.leases.controls(GS_SESSION, 1)
    for _ in range(80):
        world.pass_time(1000)
        assert world.uav.is_controlled(world.now_ms), f"not at {world.now_ms} ms"
        assert world.uav.desk.holder.obeys(GS_SESSION, world.gs.fogs[1].epoch, world.now_ms)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("pause_ms", [5000, 45_000])
def test_an_activator_that_has_lost_the_cloud_asks_no_drone_that_may_be_gone(signed: bool, pause_ms: int) -> None:
    """A drone takes a lease that is a question too, and the other activator may have asked before."""
    world = Cut(signed=signed).begin()
    world.pass_time(12_000 + pause_ms)
    may_be_gone(world, "other", "activator")
    for _ in range(200):
        world.pass_time(100)
        assert world.uav.is_controlled(world.now_ms), f"not at {world.now_ms} ms"
        assert world.uav.desk.holder.obeys(GS_SESSION, world.other.leases.epoch(1), world.now_ms)
    assert world.gs.fogs[1].drones[1].reachable


@pytest.mark.parametrize("is_there", [False, True])
def test_what_could_not_be_asked_without_the_cloud_is_asked_when_it_is_back(is_there: bool) -> None:
    world = World().start(1000)
    world.lose_subscriptions("activator", CLOUD)
    world.run("activator", world.activator.on_disconnected(CLOUD, world.now_ms))
    may_be_gone(world, "activator")
    if not is_there:
        world.deafen("uav")
    world.pass_time(5000)
    world.run("activator", world.activator.on_connected(CLOUD, world.now_ms))
    world.pass_time(CONTEST_MS + 200)
    assert world.activator.drones.links[1].up is is_there
    assert world.gs.fogs[1].drones[1].reachable is is_there


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("renewed_ms", [100, 3000, 6000])
def test_the_loss_of_the_cloud_shortens_no_control(signed: bool, renewed_ms: int) -> None:
    """The drone's newest lease may be older than the station's newest renewal."""
    world = World(signed=signed).start(11_100 + renewed_ms)
    holder = world.activator.leases.holder(1)
    assert holder is not None
    world.lose_subscriptions("activator", CLOUD)
    world.run("activator", world.activator.on_disconnected(CLOUD, world.now_ms))
    world.pass_time(holder.until_ms - world.now_ms - 500)
    assert world.uav.is_controlled(world.now_ms)
    world.pass_time(700)
    assert not world.uav.is_controlled(world.now_ms)


def may_be_gone(world: World, *names: str) -> None:
    """Activators hear the will of one of the drone's connections, which says `several`."""
    will = Inbound("drone1/reachable", encode(Presence(session=UAV_SESSION, up=False, several=True)), 1)
    if world.signed:
        will = replace(will, payload=seal("drone1").sign(will.topic, will.payload).encode())
    for name in names:
        role = getattr(world, name)
        out = role.on_message(FOG, will, world.now_ms)
        assert role.drones.links[1].gone_at_ms is not None
        world.run(name, out)


def test_who_waits_with_a_parameter_does_not_wait_for_a_former_holders() -> None:
    uav = controlled()
    sent(uav, SetParameter("MPC_XY_CRUISE", 5.0))
    sent(uav, SetParameter("MPC_Z_VEL_MAX_UP", 5.0), seq=2)
    pass_on(uav, 0)
    hear(uav, command_payload(SetParameter("MPC_TKO_SPEED", 1.0), gs_session=ANOTHER), 1250)
    out = uav.on_mavlink(value("MPC_XY_CRUISE", 3.0), 1300)
    assert words(out) == [*REFUSED, *REFUSED]
    assert [one.message.param_id for one in out if kinds([one]) == ["PARAM_REQUEST_READ"]] == ["MPC_TKO_SPEED"]


@pytest.mark.parametrize("is_late", [False, True])
def test_no_mission_is_read_for_an_item_that_may_not_be_set_any_more(is_late: bool) -> None:
    bench = Planned(PX4_HOLD, 0)
    first, *others = (SetCurrentItem(HASH, item) for item in (1, 2, 3))
    out = bench.start(1, first)
    for seq, other in enumerate(others, start=2):
        out += bench.start(seq, other, deadline_ms=100 if is_late else 60_000)
    if not is_late:
        bench.executor.permit.has_control = lambda command_id: command_id.seq == 1
    bench.now_ms += 200
    out = bench.answered(out) + bench.answered(bench.until(bench.now_ms + 300))
    assert kinds(out).count("MISSION_REQUEST_LIST") == 1
    no = (Word.EXPIRED, None) if is_late else REFUSED[0]
    assert sorted(one for one in said(out) if one[0] > 1) == [(2, *no), (3, *no)]


def test_thousands_of_parameters_may_be_too_late_at_once() -> None:
    bench = Bench()
    for seq in range(2000):
        bench.start(seq, SetParameter("MPC_XY_CRUISE", 5.0), deadline_ms=1000)
    out = said(bench.until(4000))
    assert [word for _, word, _ in out] == [Word.DENIED, *[Word.EXPIRED] * 1999]
