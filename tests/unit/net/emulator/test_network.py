"""Events change links at their times, and only while they last."""

from __future__ import annotations

from dataclasses import replace

from net.emulator.link import DROP, PASS, WAIT
from net.emulator.network import Network, SettingsStep, steps
from net.emulator.plan import Settings, ShapedPlan
from net.link_plan import EventPlan

UP, DOWN = "air:uav1:up", "air:uav1:down"
S = 1_000_000_000


def network(*events: EventPlan, up: Settings | None = None, shared: bool = False) -> tuple[ShapedPlan, Network]:
    first = replace(up or Settings(loss=0.1), shared_with=DOWN if shared else None)
    links = {UP: first, DOWN: up or Settings()}
    plan = ShapedPlan("p", 1, links, events)
    made = Network(plan)
    made.start(0)
    return plan, made


def test_an_event_begins_and_ends_at_its_times() -> None:
    _, made = network(EventPlan(20.0, UP, 5.0, {"closed": True}))
    seen = []
    while (moment := made.next_change_ns) is not None:
        made.change_until(moment - 1)
        before = made.links[UP].settings.closed
        made.change_until(moment)
        seen.append((moment, before, made.links[UP].settings.closed))
    assert seen == [(20 * S, False, True), (25 * S, True, False)]
    assert made.links[UP].settings == Settings(loss=0.1)


def test_where_events_overlap_the_later_decides_each_field() -> None:
    plan, _ = network(EventPlan(1.0, UP, 4.0, {"loss": 0.5, "delay_us": 7}), EventPlan(2.0, UP, 1.0, {"loss": 0.9}))
    assert list(steps(plan)) == [
        SettingsStep(1 * S, UP, Settings(loss=0.5, delay_us=7), {"loss": 0.5, "delay_us": 7}),
        SettingsStep(2 * S, UP, Settings(loss=0.9, delay_us=7), {"loss": 0.9, "delay_us": 7}),
        SettingsStep(3 * S, UP, Settings(loss=0.5, delay_us=7), {"loss": 0.5, "delay_us": 7}),
        SettingsStep(5 * S, UP, Settings(loss=0.1), {}),
    ]


def test_an_event_that_follows_another_at_once_leaves_no_gap() -> None:
    plan, _ = network(EventPlan(1.0, UP, 1.0, {"closed": True}), EventPlan(2.0, UP, 1.0, {"closed": True}))
    assert [step.settings.closed for step in steps(plan)] == [True, True, False]


def test_an_outage_is_the_same_however_much_is_sent() -> None:
    fates = []
    for step in (S // 4, S // 100):
        _, made = network(EventPlan(1.0, UP, 0.5, {"closed": True}), up=Settings())
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


def test_until_the_start_links_have_their_steady_figures_and_events_count_from_it() -> None:
    plan, _ = network(EventPlan(1.0, UP, 1.0, {"closed": True}))
    made = Network(plan)
    assert made.change_until(100 * S) == []
    assert made.next_change_ns is None
    made.start(100 * S)
    assert made.next_change_ns == 101 * S
    assert [step.change for step in made.change_until(101 * S)] == [{"closed": True}]
    assert made.links[UP].settings.closed


def test_jitter_and_draws_are_the_same_that_long_after_a_start() -> None:
    plan, _ = network(up=Settings(delay_us=40_000, jitter_us=10_000, loss=0.2, reordering=True))
    found = []
    for start_ns in (3 * S, 77 * S + 123):
        made = Network(plan)
        link = made.links[UP]
        for number in range(start_ns // S):  # what is sent before differs
            link.arrive(number * S, 100)
        made.start(start_ns)
        due = [link.arrive(start_ns + number * S // 100, 100) for number in range(200)]
        found.append([(due_ns - start_ns, fate) for due_ns, fate in due])
    assert found[0] == found[1]
    assert len({due_ns for due_ns, _ in found[0]}) > 100


def test_a_change_by_hand_stands_over_the_steady_figures_and_hides_events_until_it_is_let_go() -> None:
    _, made = network(EventPlan(1.0, UP, 2.0, {"delay_us": 9}))
    link = made.links[UP]
    made.hold(UP, {"loss": 0.7})
    assert link.settings == Settings(loss=0.7)
    assert made.change_until(S) == []
    assert link.settings == Settings(loss=0.7)
    assert made.let_go(UP).change == {"delay_us": 9}
    assert link.settings == Settings(loss=0.1, delay_us=9)
    assert len(made.change_until(3 * S)) == 1
    assert link.settings == Settings(loss=0.1)


def test_a_link_that_is_shut_lets_nothing_through_whatever_else_it_is_told() -> None:
    _, made = network(EventPlan(1.0, UP, 2.0, {"closed": False}))
    made.shut(UP, True)
    made.hold(UP, {"loss": 0.0})
    made.change_until(S)
    assert made.links[UP].arrive(S, 100)[1] == DROP
    made.shut(UP, False)
    assert made.links[UP].arrive(S, 100)[1] == PASS
