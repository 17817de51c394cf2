"""Profiles' files: units, inheritance, and what is said of mistakes in them."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import jsonschema
import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from net.link_plan import LinkPlan
from testbed.errors import UserError
from testbed.plan.documents import ROOT
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles import units
from testbed.plan.profiles.reading import FOLDER, PARSERS, SCHEMA_FILE, profile_names, read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve

TOPOLOGY = standard_fleet().topology()

HEADER = "# yaml-language-server: $schema=profile.schema.json"
FACTS = {"ideal", "lan", "thesis", "lte", "3g", "edge", "leo", "geo", "geo-2s", "sik", "lossy", "bursty"}


def _write(folder: Path, text: str, name: str = "own") -> str:
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return str(path)


def _resolve(name: str, folder: Path = FOLDER) -> LinksPlan:
    return resolve(read_profile(name, folder), TOPOLOGY, "scenario-1", 1)


def _refusal(folder: Path, text: str) -> str:
    """What is said of a file, without its folder."""
    with pytest.raises(UserError) as raised:
        _resolve(_write(folder, text))
    assert raised.value.exit_code == 2
    said = str(raised.value)
    assert "\n" not in said
    return said.replace(f"{folder}/", "")


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (units.parse_time_us, "25ms", 25_000),
        (units.parse_time_us, "0.5 s", 500_000),
        (units.parse_time_us, "200us", 200),
        (units.parse_rate_bps, "20Mbit", 20_000_000),
        (units.parse_rate_bps, "64 kbit", 64_000),
        (units.parse_rate_bps, "unlimited", None),
        (units.parse_share, "0.2%", 0.002),
        (units.parse_share, "100%", 1.0),
        (units.parse_packets, "100 packets", 100),
        (units.parse_packets, "1 packet", 1),
    ],
)
def test_figures_are_read_with_their_units(parse: object, text: str, value: object) -> None:
    assert callable(parse)
    assert parse(text) == value


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (units.parse_time_us, "25"),
        (units.parse_time_us, "-25ms"),
        (units.parse_time_us, "25mbit"),
        (units.parse_time_us, "25ms\n"),
        (units.parse_delay_us, "61s"),
        (units.parse_rate_bps, "20mbit"),
        (units.parse_rate_bps, "20"),
        (units.parse_rate_bps, "0kbit"),
        (units.parse_rate_bps, "200Gbit"),
        (units.parse_share, "0.2"),
        (units.parse_share, "101%"),
        (units.parse_packets, "100"),
        (units.parse_packets, "0 packets"),
        (units.parse_packets, "999999 packets"),
    ],
)
def test_other_units_and_absurd_values_are_refused(parse: object, text: str) -> None:
    assert callable(parse)
    with pytest.raises(ValueError, match=r"unit|share|packet|most|rate"):
        parse(text)


@given(st.integers(min_value=0, max_value=units.LONGEST_US))
def test_a_time_that_is_shown_is_read_back(time_us: int) -> None:
    assert units.parse_time_us(units.show_time(time_us) if time_us else "0us") == time_us


@given(st.integers(min_value=units.SLOWEST_BPS, max_value=units.FASTEST_BPS))
def test_a_rate_that_is_shown_is_read_back(rate_bps: int) -> None:
    assert units.parse_rate_bps(units.show_rate(rate_bps)) == rate_bps


@given(st.text(max_size=20))
def test_any_text_is_read_or_refused(text: str) -> None:
    for _, parse in PARSERS.values():
        with contextlib.suppress(ValueError):
            parse(text)


def test_every_profile_is_there_and_resolves() -> None:
    assert set(profile_names()) == FACTS
    assert profile_names()[0] == "ideal"
    for name in FACTS:
        assert _resolve(name).profile == name


def test_every_profile_names_its_schema_for_editors_and_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(SCHEMA_FILE.read_text()))
    for name in FACTS:
        assert (FOLDER / f"{name}.yaml").read_text().splitlines()[0] == HEADER
    assert (FOLDER / HEADER.partition("=")[2]).is_file()


def test_the_schema_and_the_parsers_know_the_same_units() -> None:
    """An editor with only the schema must not accept what the program refuses for its unit."""
    definitions = json.loads(SCHEMA_FILE.read_text())["$defs"]
    figures = definitions["figures"]["properties"]
    for name in PARSERS:
        pattern = definitions[figures[name]["$ref"].rsplit("/", 1)[1]]["pattern"]
        for text in ("25ms", "25", "1%", "20Mbit", "20mbit", "unlimited", "5 packets", "0.5 s", "-1%", "1.5 kbit"):
            accepted = jsonschema.Draft202012Validator({"pattern": pattern}).is_valid(text)
            try:
                PARSERS[name][1](text)
            except ValueError:
                assert not accepted, (name, text)
            else:
                assert accepted, (name, text)


def test_every_figure_has_a_source() -> None:
    for name in FACTS:
        for figures in _resolve(name).figures.values():
            assert all(len(figure.source) > 15 for figure in figures.values())


def test_ideal_shapes_nothing() -> None:
    assert set(_resolve("ideal").links.values()) == {LinkPlan()}


def test_a_profile_inherits_and_a_direction_stands_above_both(tmp_path: Path) -> None:
    _write(tmp_path, "description: base\nlinks: {air: {both: {delay: 5ms, loss: 1%, source: s}}}", "base")
    own = """
description: own
inherits: base
links: {air: {both: {loss: 2%, source: s}, up: {loss: 3%, source: s}}}
overrides: {"air:uav3": {down: {delay: 9ms, source: s}}}
"""
    links = _resolve(_write(tmp_path, own)).links
    assert (links["air:uav1:up"].delay_us, links["air:uav1:up"].loss) == (5_000, 0.03)
    assert (links["air:uav1:down"].delay_us, links["air:uav1:down"].loss) == (5_000, 0.02)
    assert (links["air:uav3:down"].delay_us, links["air:uav3:up"].delay_us) == (9_000, 5_000)
    assert links["wan:gs:up"] == LinkPlan()


def test_a_single_link_of_the_parent_stands_above_a_class_of_the_child(tmp_path: Path) -> None:
    _write(tmp_path, 'description: b\noverrides: {"air:uav3": {both: {delay: 9ms, source: s}}}', "base")
    own = "description: own\ninherits: base\nlinks: {air: {both: {delay: 5ms, source: s}}}"
    links = _resolve(_write(tmp_path, own)).links
    assert (links["air:uav3:up"].delay_us, links["air:uav2:up"].delay_us) == (9_000, 5_000)


def test_unlimited_lifts_an_inherited_rate_with_its_queue(tmp_path: Path) -> None:
    own = "description: own\ninherits: lte\nlinks: {air: {both: {rate: unlimited, source: s}}}"
    link = _resolve(_write(tmp_path, own)).links["air:uav1:up"]
    assert (link.rate_bps, link.queue_packets, link.delay_us) == (None, None, 45_000)


def test_a_shared_medium_names_its_other_direction() -> None:
    links = _resolve("sik").links
    assert links["air:uav2:up"].shared_with == "air:uav2:down"
    assert links["air:uav2:down"].shared_with == "air:uav2:up"
    assert links["wan:gs:up"].shared_with is None


AIR = "description: own\nlinks: {air: {both: "


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            AIR + "{delay: 25, source: s}}}",
            "own.yaml: links.air.both.delay: 25: expected a time with its unit (us, ms, s), as 25ms",
        ),
        (
            AIR + "{delay: 25mbit, source: s}}}",
            "own.yaml: links.air.both.delay: '25mbit': expected a time with its unit (us, ms, s), as 25ms",
        ),
        (
            AIR + "{delay: -5ms, source: s}}}",
            "own.yaml: links.air.both.delay: '-5ms': expected a time with its unit (us, ms, s), as 25ms",
        ),
        (AIR + "{delay: 90s, source: s}}}", "own.yaml: links.air.both.delay: '90s': expected at most 60s"),
        (
            AIR + "{loss: 120%, source: s}}}",
            "own.yaml: links.air.both.loss: '120%': expected a share from 0% to 100%, as 1%",
        ),
        (
            AIR + "{loss: 1%}}}",
            "own.yaml: links.air.both.source: missing: expected text, or for each figure its own text",
        ),
        (
            AIR + "{loss: 1%, delay: 5ms, source: {loss: s}}}}",
            "own.yaml: links.air.both.source.delay: missing: expected text that says where '5ms' comes from",
        ),
        (
            AIR + "{rate: 1Mbit, source: s}}}",
            "own.yaml: links.air.both.rate: '1Mbit': expected a queue beside it, as queue: 100 packets",
        ),
        (
            AIR + "{queue: 9 packets, source: s}}}",
            "own.yaml: links.air.both.queue: '9 packets': expected a rate beside it that it waits for",
        ),
        (
            AIR + "{delay: 5ms, jitter: 6ms, source: s}}}",
            "own.yaml: links.air.both.jitter: '6ms': expected at most the delay",
        ),
        (
            AIR + "{reorder: 5%, source: s}}}",
            "own.yaml: links.air.both.reorder: '5%': expected a delay that a reordered frame does not wait for",
        ),
        (
            AIR + "{distribution: gauss, delay: 5ms, source: s}}}",
            "own.yaml: links.air.both.distribution: 'gauss': expected normal, uniform or pareto",
        ),
        (
            AIR + "{latency: 5ms, source: s}}}",
            "own.yaml: links.air.both.latency: '5ms': unknown field: expected one of rate, queue, delay, jitter, "
            "distribution, reordering, loss, duplicate, corrupt, reorder, source",
        ),
        (
            "description: own\nlinks: {wlan: {}}",
            "own.yaml: links.wlan: {}: unknown field: expected one of wan, backhaul, air, sense",
        ),
        (
            "links: {}",
            "own.yaml: description: missing: expected one line of text, at most 100 characters",
        ),
        ("", "own.yaml: the file: None: expected a profile: description, and links, overrides, events, inherits"),
        (
            "description: own\ndescription: twice",
            "own.yaml: line 1: 'description' is there twice: expected YAML, each key once",
        ),
        (
            "description: own\ninherits: nobody",
            "own.yaml: inherits: 'nobody': expected one of ideal, 3g, bursty, edge, geo, geo-2s, lan, leo, lossy, lte, "
            "sik, thesis",
        ),
        (
            'description: own\noverrides: {"air:uav9": {both: {loss: 1%, source: s}}}',
            "own.yaml: overrides.air:uav9: no such link: expected one of wan:gs, backhaul:fog1, backhaul:fog2, "
            "air:uav1, air:uav2, air:uav3, air:uav4, air:uav5, air:uav6",
        ),
        (
            AIR + "{rate: 1Mbit, queue: 5 packets, source: s}, down: {rate: 2Mbit, source: s}, shared: true}}",
            "own.yaml: links.air.shared: 'true': expected one rate for both directions of air:uav1",
        ),
    ],
)
def test_a_mistake_is_one_line_with_file_field_value_and_what_was_expected(
    tmp_path: Path, text: str, said: str
) -> None:
    assert _refusal(tmp_path, text) == said


def test_a_circle_of_inheritance_is_refused(tmp_path: Path) -> None:
    _write(tmp_path, "description: b\ninherits: own", "other")
    assert _refusal(tmp_path, "description: a\ninherits: other") == (
        "other.yaml: inherits: 'own': expected a profile that does not come back to this one (own > other > own)"
    )


def test_broken_yaml_is_told_with_its_line(tmp_path: Path) -> None:
    said = _refusal(tmp_path, "description: [a\nlinks: {")
    assert said.startswith("own.yaml: line ")
    assert said.endswith("expected YAML, each key once")


def test_a_profile_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(UserError, match=r"PROFILE=5g: expected one of ideal, 3g, .*, or the path of a .yaml file"):
        read_profile("5g")


_JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8) | st.sampled_from(["5ms", "1%", "1Mbit", "air"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["links", "air", "both", "up", "delay", "source", "events", "link", "at", "change", "overrides"]
            )
            | st.text(max_size=5),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(_JUNK)
@example({"\n": None})
def test_any_document_is_read_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, junk: object) -> None:
    folder = tmp_path_factory.mktemp("junk")
    if isinstance(junk, dict):
        junk = {"description": "junk", **junk}
    said = "expected nothing else"
    try:
        _resolve(_write(folder, yaml.safe_dump(junk)))
    except UserError as error:
        said = str(error)
    assert "\n" not in said
    assert "expected" in said


def test_files_are_named_as_people_type_them() -> None:
    where = [figure.where for figures in _resolve("3g").figures.values() for figure in figures.values()]
    assert {place.partition(":")[0] for place in where} == {"tc_profiles/lte.yaml", "tc_profiles/3g.yaml"}
    assert (ROOT / "tc_profiles" / "3g.yaml").is_file()
