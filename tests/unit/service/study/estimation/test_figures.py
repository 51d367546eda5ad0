"""Figures of a campaign: one for each scenario, and one of all."""

from service.study.estimation.campaign import CampaignPlan, assess, collect_metrics
from service.study.estimation.figures import draw_campaign


def test_every_scenario_and_the_overview_are_drawn(judged_unit, tmp_path):
    results = (judged_unit(), judged_unit(seed=2), judged_unit("nominal"), judged_unit("white", is_silent=True))
    campaign = assess(CampaignPlan(("octants", "nominal", "white"), 2), 1.0, results, collect_metrics(results))
    paths = draw_campaign(campaign, tmp_path)
    # nothing could be driven in `white`
    assert [path.name for path in paths] == ["octants.png", "nominal.png", "overview.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_a_campaign_of_refusals_draws_nothing(judged_unit, tmp_path):
    results = (judged_unit(is_silent=True),)
    campaign = assess(CampaignPlan(("octants",), 1), 1.0, results, collect_metrics(results))
    assert draw_campaign(campaign, tmp_path) == []
