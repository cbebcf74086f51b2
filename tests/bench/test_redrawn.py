"""A redrawn chart may differ only by ties on a front."""

import pytest
from command_line import dpcontrol

from dpcontrol.bench.chart import Diagram, Point
from dpcontrol.bench.run import TIED, changes, losses


def panel(*pairs, stored=()):
    points = [Point(f"m{k}", "", t, e, stored=k in stored) for k, (t, e) in enumerate(pairs)]
    return Diagram("panel", "s", "error", tuple(points))


FIRST = panel((1.0, 1e-3), (2.0, 1e-6), (4.0, 1e-9), (4.1, 1e-8))


def test_noise_of_a_few_per_cent_changes_nothing():
    assert changes([FIRST], [panel((1.05, 1e-3), (1.92, 1e-6), (4.2, 1e-9), (4.0, 1e-8))]) == ()


def test_a_method_that_became_slower_than_another_is_reported():
    # The second is now slower than the third, which is nearer: off the front by 5 / 4.
    (text,) = changes([FIRST], [panel((1.0, 1e-3), (5.0, 1e-6), (4.0, 1e-9), (4.1, 1e-8))])
    assert text == "panel: m1 was on the front, and is 25% off it"


def test_a_method_that_moved_onto_the_front_is_reported():
    before = panel((1.0, 1e-3), (2.0, 1e-2))
    (text,) = changes([before], [panel((1.0, 1e-3), (0.5, 1e-2))])
    assert text == "panel: m1 was 100% off the front, and is on it"


def test_errors_that_changed_places_change_the_order_of_times_on_a_front():
    before, after = panel((1.0, 1e-3), (2.0, 1e-6)), panel((2.0, 1e-6), (1.0, 1e-3))
    (text,) = changes([before], [after])
    assert text == "panel: m0 took 0.5 times as long as m1, and takes 2 times"


@pytest.mark.parametrize(("slower", "told"), [(TIED * 0.9, 0), (TIED * 1.1, 1)])
def test_a_tie_is_a_fifth(slower, told):
    before = panel((1.0, 1e-3), (1.0 + slower, 1e-6))
    # Now the second is as quick as it was slow, and nearer.
    after = panel((1.0 + slower, 1e-3), (1.0, 1e-6))
    assert len(changes([before], [after])) == told


def test_points_of_one_drawing_only_have_no_order():
    assert changes([panel((1.0, 1e-3))], [panel((1.0, 1e-3), (0.1, 1e-9))]) == ()
    assert changes([], [FIRST]) == ("panel: not in the earlier drawing",)


def default(seconds, error, *, yardstick=1.0, **more):
    points = (Point("ours", "", seconds, error, default=True, yardstick=yardstick), Point("theirs", "", 1.0, 1.0))
    return (Diagram("panel", "time, s", "error", points, **more),)


def test_a_default_that_became_slower_or_less_accurate_is_reported():
    before = default(1.0, 1e-9)
    assert losses(before, default(1.9, 2.9e-9)) == ()
    assert losses(before, default(2.1, 1e-9)) == ("panel: ours takes 2.1 times the earlier cost (time, s)",)
    assert losses(before, default(1.0, 3.1e-9)) == ("panel: ours errs by 3.1e-09, and did by 1e-09",)
    assert losses(default(1.0, 1e-16, floor=1e-14), default(1.0, 9e-15, floor=1e-14)) == ()


def test_a_machine_on_which_all_work_takes_longer_makes_nothing_slower_but_what_is_no_time():
    before = default(1.0, 1e-9)
    assert losses(before, default(5.0, 1e-9, yardstick=5.0)) == ()
    assert losses(before, default(1.0, 1e-9, yardstick=0.2)) == (
        "panel: ours takes 5 times the earlier cost (time, s)",
    )
    # One of the two was not measured.
    assert losses(before, default(9.0, 1e-9, yardstick=0.0)) == ()
    assert losses(default(1.0, 1e-9, timed=False), default(5.0, 1e-9, yardstick=5.0, timed=False)) == (
        "panel: ours takes 5 times the earlier cost (time, s)",
    )


def test_an_invalid_earlier_drawing_is_rejected_before_any_work(tmp_path):
    for text in (None, "{}", '{"panels": [{"points": [{}]}]}', "no JSON"):
        if text is not None:
            (tmp_path / "propagation.json").write_text(text)
        ended = dpcontrol("bench", "propagation", "--against", str(tmp_path), "--out", str(tmp_path / "out"))
        assert ended.code == 2
        assert "propagation.json" in ended.message
        assert not (tmp_path / "out").exists()
