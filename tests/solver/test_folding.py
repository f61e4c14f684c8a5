"""Stability against lobes around the axis, against the classical buckling of a sphere and the exact invariances."""

import numpy as np
import pytest

from taichi_eye.errors import RunStopped
from taichi_eye.eye.laws import LAWS
from taichi_eye.scene import load_scene
from taichi_eye.solver.folding import LOBES, Folding
from taichi_eye.solver.reduced import Cavity
from taichi_eye.solver.simulation import Simulation

RADIUS, NU, YOUNG = 7.8e-3, 0.3, 1e6
LAW = LAWS["exponential"]
S = 1e-6  # exponent so small that the law is linear elasticity


def shell(thickness, elements=60, reach=0.5 * np.pi, strain=0.0, shear=0.0):
    angle = np.linspace(0.0, reach, elements + 1)
    nodes = RADIUS * np.column_stack([np.sin(angle), np.cos(angle)])
    a = YOUNG / (1.0 - NU**2) / (2.0 * S)
    rigidity = YOUNG * thickness**3 / (12.0 * (1.0 - NU**2))
    folding = Folding(
        nodes,
        thickness=thickness,
        law=LAW,
        coefficients=(a, S, NU),
        poisson_ratio=NU,
        prestrain=strain,
        rigidity=rigidity,
        shear=shear,
    )
    return folding, nodes


@pytest.mark.parametrize("thickness", [0.2e-3, 0.3e-3, 0.45e-3])
def test_a_sphere_folds_at_the_classical_pressure(thickness):
    critical = 2.0 * YOUNG * (thickness / RADIUS) ** 2 / np.sqrt(3.0 * (1.0 - NU**2))
    for share, stable in ((0.95, True), (1.05, False)):
        strain = -share * critical * RADIUS / (2.0 * thickness) * (1.0 - NU) / YOUNG
        folding, nodes = shell(thickness, strain=strain)
        assert (folding.lobes(nodes, np.full(len(nodes), -share * critical)) is None) == stable


@pytest.mark.parametrize("share_of_shear", [0.3, 2.0])
def test_shear_adds_its_stiffness_to_the_compression_that_a_sphere_bears(share_of_shear):
    thickness = 0.3e-3
    # per length: 2 sqrt(D E h) / R by bending, kappa G h by shear; the pressure is 2 / R times their sum
    bent = YOUNG * thickness**2 / RADIUS / np.sqrt(3.0 * (1.0 - NU**2))
    shear = share_of_shear * bent
    for share, stable in ((0.95, True), (1.05, False)):
        line = share * (bent + shear)
        strain = -line / thickness * (1.0 - NU) / YOUNG
        folding, nodes = shell(thickness, strain=strain, shear=shear)
        assert (folding.lobes(nodes, np.full(len(nodes), -2.0 * line / RADIUS)) is None) == stable


@pytest.mark.parametrize("m", [2, 6])
@pytest.mark.parametrize("dent", [0.0, 1.5e-3])
def test_the_shear_in_the_form_is_the_second_difference_of_its_energy(m, dent):
    rng = np.random.default_rng(5)
    folding, nodes = shell(0.3e-3, elements=12, reach=0.9, shear=7.0)
    # a dent turns the wall by up to 40 degrees
    place = nodes - dent * np.exp(-((nodes[:, :1] / 2e-3) ** 2)) * [0.1, 1.0]
    place[0, 0] = 0.0
    with_shear = folding.form(place, np.zeros(13), m)
    folding.shear = np.zeros(12)
    form = with_shear - folding.form(place, np.zeros(13), m)
    shift = np.zeros((13, 3))
    shift[1:-1] = 1e-6 * rng.normal(size=(11, 3))
    vector = shift[1:-1].ravel()
    energies = [shear_energy(folding, place, sign * shift, m, 7.0) for sign in (1.0, 0.0, -1.0)]
    assert energies[0] - 2.0 * energies[1] + energies[2] == pytest.approx(
        np.pi * vector @ form @ vector / 2.0, rel=1e-3
    )


def shear_energy(folding, place, shift, m, stiffness, samples=96):
    """kappa G h / 2 of the squared tangent between the surface's normal and that at rest, over the surface at rest."""
    mean = lambda v: 0.5 * (v[1:] + v[:-1])  # noqa: E731
    angle = np.arctan2(-np.diff(folding.rest[:, 1]), np.diff(folding.rest[:, 0]))
    frozen = np.array([np.sin(angle), np.zeros(12), np.cos(angle)])
    total = 0.0
    for phi in 2.0 * np.pi * (np.arange(samples) + 0.5) / samples:
        c, s = np.cos(m * phi), np.sin(m * phi)
        r, t, z = place[:, 0] + shift[:, 0] * c, shift[:, 1] * s, place[:, 1] + shift[:, 2] * c
        rp, tp, zp = -m * shift[:, 0] * s, m * shift[:, 1] * c, -m * shift[:, 2] * s
        along = np.array([np.diff(v) / folding.length for v in (r, t, z)])
        around = np.array([mean(rp - t), mean(r + tp), mean(zp)])
        normal = np.cross(along, around, axis=0)
        cosine = (normal * frozen).sum(0) / np.linalg.norm(normal, axis=0)
        total += (0.5 * stiffness * folding.radius * folding.length * (1.0 / cosine**2 - 1.0)).sum()
    return total * 2.0 * np.pi / samples


def test_a_state_that_is_not_finite_is_not_called_a_fold():
    folding, nodes = shell(0.3e-3, elements=12)
    broken = nodes.copy()
    broken[5, 1] = np.nan
    assert folding.lobes(broken, np.zeros(13)) is None and folding.lobes(nodes, np.full(13, np.nan)) is None


def test_pressure_from_within_bears_any_tension():
    folding, nodes = shell(0.3e-3, strain=0.004)
    pressure = 2.0 * 0.3e-3 / RADIUS * LAW.of_arrays.stress(0.004, 0.004, 0.0, folding.coefficients)[0]
    assert folding.lobes(nodes, np.full(len(nodes), pressure)) is None


@pytest.mark.parametrize("m", [LOBES[0], 7])
def test_form_is_the_second_difference_of_the_membrane_energy(m):
    rng = np.random.default_rng(11)
    folding, nodes = shell(0.3e-3, elements=12, reach=0.9, strain=0.01)
    folding.rigidity = np.zeros(12)
    place = nodes * (1.0 + 0.01 * rng.normal(size=nodes.shape))
    place[0, 0] = 0.0
    shift = np.zeros((13, 3))
    shift[1:-1] = 1e-6 * rng.normal(size=(11, 3))
    form = folding.form(place, np.zeros(13), m)
    vector = shift[1:-1].ravel()
    up, here, down = (energy(folding, place, sign * shift, m) for sign in (1.0, 0.0, -1.0))
    # over the circle cos^2 averages to half: the form counts pi of it
    assert up - 2.0 * here + down == pytest.approx(np.pi * vector @ form @ vector / 2.0, rel=1e-4)


def energy(folding, place, shift, m, samples=96):
    """Membrane energy [J] of the perturbed surface, integrated around the axis."""
    total = 0.0
    angles = 2.0 * np.pi * (np.arange(samples) + 0.5) / samples
    for phi in angles:
        c, s = np.cos(m * phi), np.sin(m * phi)
        r, t, z = place[:, 0] + shift[:, 0] * c, shift[:, 1] * s, place[:, 1] + shift[:, 2] * c
        rp, tp, zp = (-m * shift[:, 0] * s, m * shift[:, 1] * c, -m * shift[:, 2] * s)
        along = np.array([np.diff(v) / folding.length for v in (r, t, z)])
        mean = lambda v: 0.5 * (v[1:] + v[:-1])  # noqa: E731
        around = np.array([mean(rp - t), mean(r + tp), mean(zp)]) / folding.radius
        e1, e2 = (
            0.5 * ((along**2).sum(0) - 1.0) + folding.prestrain,
            0.5 * ((around**2).sum(0) - 1.0) + folding.prestrain,
        )
        shear = 0.5 * (along * around).sum(0)
        exponent = S * ((1.0 - NU) * (e1**2 + e2**2 + 2.0 * shear**2) + NU * (e1 + e2) ** 2)
        total += (
            folding.thickness * folding.radius * folding.length * folding.coefficients[0] * np.expm1(exponent)
        ).sum()
    return total * 2.0 * np.pi / samples


THIN_IN_BENDING = (
    "cornea.stiffness_a_pa=220000",
    "cornea.flexural_modulus_mpa=0.016",
    "numerics.spacing_mm=0.2",
    "numerics.sound_speed_m_s=20",
    "numerics.duration_ms=15",
    "cornea.viscoelastic_share=0.5",
    "cornea.relaxation_ms=0.4",
    "chamber.compliance_mm3_mmhg=0.15",
    "puff.peak_kpa=12.85",
)


@pytest.mark.parametrize("make", [lambda scene: Cavity(scene), Simulation])
def test_a_shell_too_thin_in_bending_folds_and_is_stopped_there(make):
    eye = make(load_scene(None, THIN_IN_BENDING))
    with pytest.raises(RunStopped) as stopped:
        eye.run()
    assert "lobes" in stopped.value.what and 8.0 < stopped.value.time_ms < 14.0
    # the ring around the dent
    assert 1.0 < float(stopped.value.where.split("=")[1].split()[0]) < 3.0
    times = eye.traces["time_ms"]
    assert times[-1] <= stopped.value.time_ms and np.isfinite(eye.traces["apex_displacement_mm"]).all()


def test_a_shell_four_times_as_stiff_in_bending_does_not():
    thick = [*THIN_IN_BENDING, "cornea.stiffness_a_pa=110000", "cornea.flexural_modulus_mpa=0.065"]
    traces = Cavity(load_scene(None, thick)).run()
    assert traces["apex_displacement_mm"].max() > 0.3 and traces["cornea_min_stress_kpa"].min() < -30.0
