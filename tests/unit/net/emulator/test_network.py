"""Events change links at their times, and only while they last."""

from __future__ import annotations

from net.emulator.link import DROP, PASS, WAIT
from net.emulator.network import Network, changes
from net.emulator.plan import Event, LinkPlan, Plan, Settings

UP, DOWN = "air:uav1:up", "air:uav1:down"
S = 1_000_000_000


def network(*events: Event, up: Settings | None = None, shared: bool = False) -> tuple[Plan, Network]:
    links = {UP: LinkPlan(up or Settings(loss=0.1), DOWN if shared else None), DOWN: LinkPlan(up or Settings())}
    plan = Plan("p", 1, links, events)
    return plan, Network(plan)


def test_an_event_begins_and_ends_at_its_times() -> None:
    _, made = network(Event(20.0, UP, 5.0, {"closed": True}))
    seen = []
    while (moment := made.next_change_ns) is not None:
        made.change_until(moment - 1)
        before = made.links[UP].settings.closed
        made.change_until(moment)
        seen.append((moment, before, made.links[UP].settings.closed))
    assert seen == [(20 * S, False, True), (25 * S, True, False)]
    assert made.links[UP].settings == Settings(loss=0.1)


def test_where_events_overlap_the_later_decides_each_field() -> None:
    plan, _ = network(Event(1.0, UP, 4.0, {"loss": 0.5, "delay_us": 7}), Event(2.0, UP, 1.0, {"loss": 0.9}))
    assert list(changes(plan)) == [
        (1 * S, UP, Settings(loss=0.5, delay_us=7)),
        (2 * S, UP, Settings(loss=0.9, delay_us=7)),
        (3 * S, UP, Settings(loss=0.5, delay_us=7)),
        (5 * S, UP, Settings(loss=0.1)),
    ]


def test_an_event_that_follows_another_at_once_leaves_no_gap() -> None:
    plan, _ = network(Event(1.0, UP, 1.0, {"closed": True}), Event(2.0, UP, 1.0, {"closed": True}))
    assert [settings.closed for _, _, settings in changes(plan)] == [True, True, False]


def test_an_outage_is_the_same_however_much_is_sent() -> None:
    fates = []
    for step in (S // 4, S // 100):
        _, made = network(Event(1.0, UP, 0.5, {"closed": True}), up=Settings())
        found = {}
        for now in range(0, 3 * S, step):
            made.change_until(now)
            found[now] = made.links[UP].arrive(now, 100)[1]
        fates.append({now: fate for now, fate in found.items() if now % (S // 4) == 0})
    assert fates[0] == fates[1]
    assert [now for now, fate in fates[0].items() if fate == DROP] == [S, S + S // 4]


def test_a_shared_rate_is_one_whichever_link_names_the_other() -> None:
    _, made = network(up=Settings(rate_bps=1_000_000), shared=True)
    (turns,) = made.turns
    for link in made.links.values():
        assert link.arrive(0, 125)[1] == WAIT
    assert list(turns.advance(S)) == [(made.links[UP], S // 1000, PASS), (made.links[DOWN], 2 * S // 1000, PASS)]
