"""A team of threads does with an eye what one thread does with it, however its lanes get ahead of one another."""

import math

import numpy as np
import pytest
from plain import PartedWays, in_turns

from taichi_eye.lang import ti
from taichi_eye.scene import load_scene
from taichi_eye.solver import team
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.coupling import plan_of
from taichi_eye.solver.figures import NOT_CONVERGED, QUANTITIES, at

COARSE = ("numerics.spacing_mm=0.5", "numerics.sound_speed_m_s=20")
# all that a wall may have: a shell that shears and relaxes under a jet that feels the dent, a globe behind; an open
# chamber without slip; loose coupling
EYES = (
    (
        "cornea.flexural_modulus_mpa=0.1",
        "cornea.viscoelastic_share=0.3",
        "cornea.shear_modulus_kpa=10",
        "cornea.shear_viscosity_ms=0.1",
        "chamber.compliance_mm3_mmhg=0.2",
        "chamber.globe_law=friedenwald",
        "chamber.globe_delay_ms=0.5",
        "puff.dent_feedback=0.5",
        "numerics.spacing_mm=0.5",
    ),
    ("chamber.sealed=false", "numerics.wall_condition=no_slip"),
    ("numerics.coupling=loose", "eye.iop_mmhg=25"),
)
DT, STEPS = 2e-6, 3


class Eyes:
    """Three unlike eyes that a sudden puff has set in motion, and what is to be done next, by eye."""

    def __init__(self):
        self.batch = Batch([load_scene(None, (*COARSE, *keys)) for keys in EYES])
        self.plan = plan_of(
            np.arange(3), np.full(3, STEPS), np.full(3, DT), np.full(3, DT), np.full((3, STEPS), 4000.0)
        )
        self.coupling = self.batch.coupling
        for _ in range(8):
            self.coupling.march_all(self.plan)

    def stretch(self, eye):
        """The nodes of an eye."""
        return slice(int(self.batch.first[eye]), int(self.batch.first[eye]) + self.batch.clouds[eye].count)

    def figures(self, coupling, eye):
        """All that a step leaves of an eye, by name, of a coupling or of a plain one."""
        cornea, aqueous = coupling.cornea, coupling.aqueous
        fields = {**self.batch.cornea.evolving(), **self.batch.aqueous.evolving()}
        of_eyes = {**self.batch.cornea.evolving_of_eyes(), **self.batch.aqueous.evolving_of_eyes()}
        found = {}
        for name in fields:
            owner, own = (cornea, name[7:]) if name.startswith("cornea_") else (aqueous, name[8:])
            values = getattr(owner, own).to_numpy()[self.stretch(eye)]
            found[name] = values.reshape(len(values), -1)
        for name in of_eyes:
            owner = (
                aqueous.globe if name.startswith("globe_") else aqueous if hasattr(self.batch.aqueous, name) else cornea
            )
            found[name] = getattr(owner, name.removeprefix("globe_")).to_numpy()[eye]
        for name in ("sweeps", "worst_residual", "status"):
            found[name] = getattr(coupling, name).to_numpy()[eye]
        return found


@pytest.fixture(scope="module")
def eyes():
    return Eyes()


@pytest.fixture(scope="module")
def after(eyes):
    """What one thread makes of each eye, from the state in which `eyes` leaves it; the state is put back."""
    workspace = eyes.batch._workspace
    count = eyes.stretch(2).stop
    before = workspace.snapshot.take(count, 3)
    eyes.coupling.march_all(eyes.plan)
    found = [eyes.figures(eyes.coupling, eye) for eye in range(3)]
    rows = np.zeros((3, len(QUANTITIES)))
    eyes.batch.survey.measure(np.arange(3, dtype=np.int32), rows)
    workspace.snapshot.put(before)
    return found, rows


def by_team(eyes, eye, lanes, seed):
    rng = np.random.default_rng(seed)
    work = lambda lane, coupling: coupling.march(eye, lane, eye, eyes.plan)
    return in_turns(lanes, rng, eyes.coupling, work)


def assert_close(found, expected, tolerance=1e-12):
    for name, values in expected.items():
        scale = np.abs(values).max()
        np.testing.assert_allclose(found[name], values, rtol=0, atol=tolerance * scale, err_msg=name)


@pytest.mark.parametrize("eye", range(3))
def test_lanes_in_any_order_do_what_one_thread_does(eyes, after, eye):
    expected = after[0][eye]
    for lanes in (2, 3, 40):
        first, again = (eyes.figures(by_team(eyes, eye, lanes, seed), eye) for seed in (lanes, 100 + lanes))
        assert_close(first, expected)
        # to the same bits, whoever comes first
        for name, values in first.items():
            np.testing.assert_array_equal(again[name], values, err_msg=name)
