"""A walk that does not exist at its energy is refused with an energy at which it does."""

import re
from pathlib import Path

import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.planning import shadowing_orbit

CROSSING = 'model = "lab"\nenergy = {energy}\nwalk = ["down-up > up-down"]\n'


@pytest.mark.slow
def test_an_energy_without_the_connection_is_refused_with_one_that_has_it(tmp_path: Path) -> None:
    file = tmp_path / "crossing.toml"
    file.write_text(CROSSING.format(energy=0.178))
    with pytest.raises(InputError) as refused:
        shadowing_orbit(load_itinerary(str(file)))
    advised = re.search(r"at (\S+) J there are connections for each symbol$", str(refused.value))
    assert advised is not None, str(refused.value)
    file.write_text(CROSSING.format(energy=advised[1]))
    assert shadowing_orbit(load_itinerary(str(file))).converged
