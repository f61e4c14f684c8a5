"""The relaxing part of the cornea's stress against the exact answers of quasi-linear viscoelasticity."""

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.eye.tissue import flexural_rigidity
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.scene import load_scene
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.reduced import Cavity
from taichi_eye.solver.simulation import Simulation

ELEMENTS, RADIUS, RIM, THICKNESS = 16, 7.8e-3, 5.8e-3, 0.55e-3
SHARE, TIME = 0.7, 1.3e-3


@ti.data_oriented
class Probe:
    """A cap of tissue whose nodes are put where the test wants them."""

    def __init__(self, share=SHARE, flexural_modulus=0.0):
        backend.real()
        angle = np.linspace(0.0, np.arcsin(RIM / RADIUS), ELEMENTS + 1)
        self.nodes = RADIUS * np.column_stack([np.sin(angle), np.cos(angle)])
        self.cornea = Cornea(ELEMENTS + 1)
        self.cornea.setup(
            self.nodes,
            thickness=THICKNESS,
            density=1050.0,
            coefficients=(1562.0, 57.0, 0.4),
            prestrain=0.04,
            iop=2000.0,
            load_shape=np.zeros(ELEMENTS + 1),
            rigidity=flexural_rigidity(flexural_modulus, THICKNESS, 0.4),
            overstress_share=share,
            relaxation_time=TIME,
        )
        self.rest = self.cornea.stress.to_numpy()[:ELEMENTS]

    @ti.kernel
    def _deform(self, dt: float):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.cornea.deform(0, dt)

    def move(self, place, dt):
        """Put the nodes at `place` in a step of dt; the stresses [elements, 2] and the work of the overstress [J]."""
        self.cornea.place.from_numpy(np.ascontiguousarray(place))
        self._deform(float(dt))
        return self.cornea.stress.to_numpy()[:ELEMENTS], self.cornea.relaxed_work[0]

    @ti.kernel
    def shake(self, nodes: ti.types.ndarray(), shift: ti.types.ndarray(), period: float, steps: int, cycles: int):
        """Move the nodes by sin(2 pi t / period) of the shift, so many cycles of so many steps."""
        ti.loop_config(serialize=True)
        for n in range(1, cycles * steps + 1):
            share = ti.sin(2.0 * np.pi * n / steps)
            for i in range(ELEMENTS + 1):
                for c in ti.static(range(2)):
                    self.cornea.place[i][c] = nodes[i, c] + share * shift[i, c]
            self.cornea.deform(0, period / steps)


def test_sudden_stretch_meets_the_sudden_stiffness_and_relaxes():
    relaxing, elastic = Probe(), Probe(share=0.0)
    slow, _ = elastic.move(1.004 * elastic.nodes, 1e-9)
    sudden, _ = relaxing.move(1.004 * relaxing.nodes, 1e-9)
    np.testing.assert_allclose(sudden - slow, SHARE * (slow - relaxing.rest), rtol=1e-5)
    for t in (0.5e-3, 2.0e-3, 40e-3):
        before = relaxing.cornea.overstress.to_numpy()[:ELEMENTS]
        held, _ = relaxing.move(1.004 * relaxing.nodes, t)
        np.testing.assert_allclose(held - slow, before * np.exp(-t / TIME), rtol=1e-9, atol=1e-9 * np.abs(slow).max())


def test_even_ramp_is_met_exactly_whatever_the_step():
    rng = np.random.default_rng(5)
    cuts = np.sort(np.append(rng.uniform(0.0, 4e-3, 7), [0.0, 4e-3]))
    # stress at rest is far from zero; what counts is that it changes evenly: find the stretches that make it so
    finder = Probe(share=0.0)
    full, _ = finder.move(1.006 * finder.nodes, 1e-6)
    stretches = []
    for share in cuts[1:] / 4e-3:
        low, high = 1.0, 1.006
        for _ in range(60):
            middle = 0.5 * (low + high)
            found, _ = finder.move(middle * finder.nodes, 1e-6)
            below = (found - finder.rest)[0, 0] < share * (full - finder.rest)[0, 0]
            low, high = (middle, high) if below else (low, middle)
        stretches.append(low)
    ramp = Probe()
    for stretch, dt in zip(stretches, np.diff(cuts)):
        stress, _ = ramp.move(stretch * ramp.nodes, dt)
    rate = (full - finder.rest) / 4e-3
    np.testing.assert_allclose(stress - full, SHARE * rate * TIME * (1.0 - np.exp(-4e-3 / TIME)), rtol=1e-7)


@pytest.mark.parametrize("period_over_time", [2.0, 2.0 * np.pi, 30.0])
@pytest.mark.parametrize("bent", [False, True])
def test_loss_per_cycle_is_that_of_the_loss_modulus(period_over_time, bent):
    probe = Probe(flexural_modulus=2e5)
    period, steps, small = period_over_time * TIME, 400, 1e-5
    x = 2.0 * np.pi / period_over_time
    shift = probe.nodes * small
    if bent:
        # inextensible to first order it is not; the bending part is what a shell has over a membrane
        shift = np.column_stack([np.zeros(ELEMENTS + 1), small * (RIM**2 - probe.nodes[:, 0] ** 2) / RIM])
    stored = _quadratic(probe, shift)
    probe.shake(probe.nodes, shift, period, steps, 7)
    before = probe.cornea.relaxed_work[0]
    probe.shake(probe.nodes, shift, period, steps, 1)
    work = probe.cornea.relaxed_work[0]
    # energy a^2 K / 2 at amplitude a; loss 2 pi times its half times the loss modulus
    loss = 2.0 * np.pi * stored * SHARE * x / (1.0 + x * x)
    assert work - before == pytest.approx(loss, rel=2e-3)


def _quadratic(probe, shift):
    """Second-order energy [J] of a small shift from rest: the work of the forces' linear part."""
    step = 1e-3
    up, down = (_stress_and_moment(probe, probe.nodes + sign * step * shift) for sign in (1, -1))
    strain, stress = (up[0] - down[0]) / (2 * step), (up[1] - down[1]) / (2 * step)
    volume = probe.cornea.element_volume.to_numpy()[:ELEMENTS]
    bend, moment = (up[2] - down[2]) / (2 * step), (up[3] - down[3]) / (2 * step)
    return 0.5 * float((volume[:, None] * strain * stress).sum() + (bend * moment).sum())


def _stress_and_moment(probe, place):
    still = Probe(share=0.0, flexural_modulus=2e5)
    stress, _ = still.move(place, 1e-6)
    flexure = still.cornea.flexure.to_numpy()[:ELEMENTS]
    moment = still.cornea.moment.to_numpy()[:ELEMENTS]
    return still.cornea.strain.to_numpy()[:ELEMENTS], stress, moment / flexure, moment


QUICK = (
    "numerics.spacing_mm=0.4",
    "numerics.sound_speed_m_s=20",
    "cornea.viscoelastic_share=0.8",
    "cornea.relaxation_ms=0.5",
    "cornea.flexural_modulus_mpa=0.05",
)


@pytest.mark.parametrize("make", [lambda scene: Cavity(scene), Simulation])
def test_energy_closes_and_the_tissue_takes_some(make):
    traces = make(load_scene(None, QUICK)).run()
    work = np.abs(traces["puff_work_uj"]).max()
    assert traces["tissue_loss_uj"][-1] > 0.01 * work
    assert np.abs(traces["energy_error_uj"]).max() < 0.01 * work
    # at any time the whole work against the overstress is positive: it starts from rest
    assert traces["tissue_loss_uj"].min() > -1e-6 * work


def test_very_slow_and_very_fast_relaxation_are_the_two_elastic_limits():
    base = QUICK[:2]
    peak = lambda *more: Cavity(load_scene(None, [*base, *more])).run()["apex_displacement_mm"].max()  # noqa: E731
    slow = peak("cornea.viscoelastic_share=0.5", "cornea.relaxation_ms=0.01")
    assert slow == pytest.approx(peak(), rel=2e-3)
    assert peak("cornea.viscoelastic_share=0.5", "cornea.relaxation_ms=1e6") < 0.97 * slow
