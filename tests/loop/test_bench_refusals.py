"""What settings of benches and loops refuse, each kind by the name of what is wrong."""

import math
from collections.abc import Callable
from functools import partial

import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.bench import DisturbanceSettings, DriveSettings, MechanicsSettings, Push, SensorSettings
from dpcontrol.loop.loop import LoopSettings


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (partial(DriveSettings, delay=math.nan), "delay"),
        (partial(DriveSettings, jerk=0.0), "jerk"),
        (partial(SensorSettings, dropout=1.5), "dropout"),
        (partial(SensorSettings, counts=0, missed_counts=3.0), "counts"),
        (partial(DisturbanceSettings, pushes=-1), "pushes"),
        (partial(Push, 0.0, knock=math.inf), "knock"),
        (partial(MechanicsSettings(play=(0.1, 0.2)).of_each, "play", 3), "play"),
        (partial(LoopSettings, seed=0, rate=0.0), "rate"),
        (partial(LoopSettings, seed=0, mismatch=2.0), "mismatch"),
    ],
)
def test_what_has_no_meaning_is_refused_by_name(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()
