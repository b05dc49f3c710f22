"""The examples of the gap name what is hidden: that of the README, and a simulator of one's own."""

import runpy
from pathlib import Path

import pytest
from matplotlib.figure import Figure

EXAMPLES = Path(__file__).parents[2] / "examples" / "gap"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hidden", "closed"),
    [
        ("workflow", {"brake_rotor", "load_drift", "hum", "noise"}, 0.9),
        ("own_simulator", {"soft_shaft", "hum"}, 0.5),
    ],
)
def test_example_names_what_is_hidden(name, hidden, closed, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    result = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")["result"]
    assert {effect.effect_id for effect in result.named} == hidden
    assert not result.remainder.unexplained
    assert min(proof.result.grr for proof in result.proof) > closed
