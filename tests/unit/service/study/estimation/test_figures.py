"""Figures of a campaign: one for each scenario, and one of all."""

from dataclasses import replace

import numpy as np

from service.study.estimation.campaign import CampaignPlan, assess, collect_metrics
from service.study.estimation.figures import draw_campaign
from service.study.estimation.unit import Rain


def test_every_scenario_and_the_overview_are_drawn(judged_unit, tmp_path):
    results = (judged_unit(), judged_unit(seed=2), judged_unit("nominal"), judged_unit("white", is_silent=True))
    campaign = assess(CampaignPlan(("octants", "nominal", "white"), 2), 1.0, results, collect_metrics(results))
    paths = draw_campaign(campaign, tmp_path)
    # nothing could be driven in `white`
    assert [path.name for path in paths] == ["octants.png", "nominal.png", "overview.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_the_storm_over_most_stations_is_drawn(judged_unit, tmp_path):
    results = []
    for seed, stations in ((1, 3), (2, 5), (3, 2)):
        one = judged_unit("octants", seed)
        shape = (len(one.course.hours), 6)
        rain = Rain(np.where(np.arange(6) < stations, 1.0, 0.0) * np.ones(shape), np.zeros(shape, dtype=int))
        results.append(replace(one, course=one.course._replace(rain=rain)))
    few, most = (
        draw_campaign(assess(CampaignPlan(("octants",), 1), 1.0, some, collect_metrics(some)), tmp_path)
        for some in (results[2:], results)
    )
    assert [path.name for path in few] == ["octants.png", "overview.png"]
    assert [path.name for path in most] == ["octants.png", "storm_octants.png", "overview.png"]


def test_a_campaign_of_refusals_draws_nothing(judged_unit, tmp_path):
    results = (judged_unit(is_silent=True),)
    campaign = assess(CampaignPlan(("octants",), 1), 1.0, results, collect_metrics(results))
    assert draw_campaign(campaign, tmp_path) == []
