"""Work of hours or gigabytes is rejected with an estimate of its cost, and starts with --yes."""

from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.bench.chart import CHARTS
from dpcontrol.bench.run import charts_cost
from dpcontrol.foundation.errors import GoalMissed, InputError, Remark
from dpcontrol.foundation.progress import MOST_BYTES, MOST_SECONDS, Cost, announce
from dpcontrol.plans.itinerary import itinerary_from, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import plan_cost

WALK = ("walk", "lab", "--energy", "0.2")
TURN = ("-s", "down-up +")


@pytest.mark.parametrize(
    ("call", "key"),
    [
        ((*WALK, *TURN, *TURN, "--wraps", "100000", "--solve"), "--wraps"),
        ((*WALK, *TURN, *TURN, "--wraps", "9999999999999999", "--solve"), "--wraps"),
        ((*WALK, *(TURN * 5000), "--solve"), "-s"),
        ((*WALK, "--random", "1000000000"), "--random"),
        ((*WALK, "--random", "1", "--lengths", "1", "1000000000"), "--lengths"),
        (("bifurcations", "lab", "--from", "down-up", "--to", "down-up", "--energies", "-0.11", "-0.09", "--samples",
          "1000000"), "samples"),
        ((*WALK, "--hits", "9,9", "--length", "1"), "hits up to 9,9: up to 243 searches"),
        (("import", "--simulated", "lab", "--swings", "1000000000"), "swings"),
        (("import", "--simulated", "lab", "--swings", "1000", "--seconds", "1000"), "swings"),
    ],
    ids=["wraps", "absurd wraps", "symbols", "random", "lengths", "samples", "hits", "swings", "long swings"],
)  # fmt: skip
def test_endless_work_is_rejected_before_it_starts(call: tuple[str, ...], key: str) -> None:
    ended = dpcontrol(*call)
    assert ended.code == 2
    assert ended.message.startswith(f"dpcontrol: {key}")
    assert "will take about" in ended.message
    assert "the limit is 60 minutes and 4 GB: reduce the work" in ended.message


@pytest.mark.parametrize("verb", ["plan", "run", "campaign", "rig"])
@pytest.mark.parametrize(("key", "value"), [("wraps", "[100000]"), ("lead_in", "1000000"), ("repeat", "10000")])
def test_an_endless_itinerary_is_rejected_with_file_and_key(
    verb: str, key: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    values = {"wraps": "[3]", key: value} | ({"wraps": "[3, 3]"} if key == "repeat" else {})
    lines = ['walk = ["down-up +", "down-up +"]', "energy = 0.2", *(f"{k} = {v}" for k, v in values.items())]
    Path("long.toml").write_text("\n".join(lines))
    ended = dpcontrol(verb, "long.toml")
    assert ended.code == 2
    assert ended.message.startswith("dpcontrol: long.toml: ")
    assert "periods will take about" in ended.message
    assert {path.name for path in tmp_path.iterdir()} == {"long.toml"}


def test_a_campaign_of_too_many_cases_or_runs_is_rejected() -> None:
    many = [k / 1e5 for k in range(200)]
    with pytest.raises(InputError, match="over: 40,000 cases"):
        dp.campaign("outer-turn", over={"mismatch": many, "lag": many})
    with pytest.raises(InputError, match=r"200,000,000 runs of 200 cases.* will take about .*days.*yes=True"):
        dp.campaign("outer-turn", runs=1_000_000, over={"mismatch": many})


@pytest.mark.slow
def test_a_campaign_of_a_thousand_cases_is_estimated_and_rejected_beyond_an_hour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 100 runs each: 41 minutes on two processors, below the limit; 200 runs need more."""

    def begun(*_: object, **__: object) -> None:
        raise GoalMissed("begun")

    monkeypatch.setattr("dpcontrol.runs.campaign.run_locally", begun)
    over = {"mismatch": [k / 1e4 for k in range(1000)]}
    with pytest.raises(GoalMissed, match="begun"), pytest.warns(Remark, match=r"100,000 runs of 1,000 cases.*minutes"):
        dp.campaign("outer-turn", over=over, runs=100, workers=2)
    with pytest.raises(InputError, match=r"200,000 runs of 1,000 cases.* will take about .*60 minutes and 4 GB"):
        dp.campaign("outer-turn", over=over, runs=200, workers=2)


def test_an_atlas_is_estimated_and_rejected_beyond_an_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_model("lab")
    monkeypatch.setattr("dpcontrol.walks.edges._SEARCHED", 1e4)
    with pytest.raises(InputError, match=r"hits up to 2,2: up to 2 searches will take about .* reduce the work"):
        dp.atlas(model, energy=-0.07, fresh=True)
    ended = dpcontrol("atlas", "lab", "--energy", "-0.07", "--fresh")
    assert ended.code == 2
    assert "reduce the work, or add --yes" in ended.message

    def begun(*_: object, **__: object) -> None:
        raise GoalMissed("begun")

    monkeypatch.setattr("dpcontrol.walks.edges.find_connections", begun)
    assert dpcontrol("atlas", "lab", "--energy", "-0.07", "--fresh", "--yes").code == 1


def test_charts_are_estimated_and_rejected_beyond_an_hour(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert 600 < charts_cost(tuple(CHARTS), quick=False).seconds < MOST_SECONDS / 2
    assert charts_cost(tuple(CHARTS), quick=True).seconds < 300
    monkeypatch.setattr("dpcontrol.bench.run._SECONDS", {False: 1e4})
    ended = dpcontrol("bench", "--out", str(tmp_path / "charts"))
    assert ended.code == 2
    assert ended.message.startswith(f"dpcontrol: bench: {len(CHARTS)} charts will take about ")
    assert "the limit is 60 minutes and 4 GB: reduce the work, or add --yes" in ended.message
    assert not list(tmp_path.iterdir())


def test_python_rejects_long_work_and_names_its_keyword() -> None:
    model = load_model("lab")
    with pytest.raises(InputError, match=r"samples.*will take about.*reduce the work"):
        dp.find_bifurcations(model, "down-up", "down-up", energies=(-0.11, -0.09), samples=10**6)
    found = dp.graph(model, energy=-0.07)
    with pytest.raises(InputError, match=r"wraps.*will take about.*reduce the work"):
        dp.shadow(found, ["down-up +", "down-up +"], wraps=[500_000])
    with pytest.raises(InputError, match=r"swings = 1000000.*will take about.*reduce the work"):
        dp.swings(model, count=10**6)


@pytest.mark.parametrize("begin", [dp.run, dp.campaign, dp.plan])
def test_python_rejects_an_endless_itinerary_without_yes(
    begin: Callable[..., object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "long.toml"
    file.write_text('walk = ["down-up +", "down-up +"]\nenergy = 0.2\nwraps = [100_000]\n')
    with pytest.raises(InputError, match=r"long.toml: wraps, 100,000 in all: .* will take about .*yes=True in Python"):
        begin(str(file))

    def planned(*_: object, **__: object) -> None:
        raise GoalMissed("begun")

    monkeypatch.setattr("dpcontrol.plans.planning.planned", planned)
    with pytest.raises(GoalMissed, match="begun"), pytest.warns(Remark, match="will take about"):
        begin(str(file), yes=True)


def test_work_with_yes_starts_and_is_announced() -> None:
    long = Cost("a year's work", 3e7, 1e9, "years = 1")
    with pytest.raises(InputError, match=r"^years = 1: a year's work will take about 350 days and 1 GB"):
        announce(long, yes=False)
    with pytest.warns(Remark, match="will take about 350 days"):
        announce(long, yes=True)


def test_shipped_itineraries_are_planned_without_yes() -> None:
    for file in Path(dp.__file__).parent.parent.joinpath("itineraries").glob("*.toml"):
        foretold = plan_cost(load_itinerary(str(file)))
        # Fifty-six transfers of three arms take a quarter of an hour.
        assert foretold.seconds < MOST_SECONDS / (3 if file.stem == "fifty-six" else 10)
        assert foretold.memory < MOST_BYTES / 4


def test_the_cost_of_a_plan_grows_with_each_thing_that_lengthens_it() -> None:
    model = load_model("lab")
    base = 'walk = ["down-up +", "down-up +"]\nenergy = 0.2\nwraps = [{}]\nlead_in = {}\nlead_out = {}\n'
    plain, *longer = (
        plan_cost(itinerary_from(base.format(*numbers), "x", model)).seconds
        for numbers in ((3, 2, 2), (4, 2, 2), (3, 3, 2), (3, 2, 3))
    )
    assert all(one > plain for one in longer)


@pytest.mark.slow
def test_transfers_between_holds_count_in_the_cost_of_a_plan() -> None:
    model = load_model("lab")
    ends = 'start = "rest"\nfinish = "rest"\n'
    costs = [
        plan_cost(itinerary_from(ends + '[[parts]]\nhold = "up-up"\n' * count, "x", model)) for count in (1, 2, 2000)
    ]
    assert costs[0].seconds < costs[1].seconds
    assert "2,001 transfers" in costs[2].work
    with pytest.raises(InputError, match=r"x.toml: parts, 2,000 in all: .*will take about"):
        announce(costs[2], yes=False)
