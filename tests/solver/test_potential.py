"""Flow maps of the chamber against potential flow in closed form."""

import numpy as np
import pytest
from scipy.special import j0, jn_zeros

from taichi_eye.cloud.packing import pack
from taichi_eye.eye.section import Section
from taichi_eye.proof.comparison import order
from taichi_eye.proof.domains import Vessel, vessel_cloud
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.potential import LayerFlow, PotentialFlow
from taichi_eye.solver.rings import ring_areas

TISSUE = {
    "thickness": 5.5e-4,
    "density": 1050.0,
    "coefficients": (1562.0, 86.1 / 1.49, 0.49),
    "prestrain": 0.04,
    "iop": 2000.0,
}
RADIUS, DEPTH = 6e-3, 3e-3


@pytest.fixture(scope="module")
def fields():
    cornea, aqueous = Cornea(64), Aqueous(1024, "quadratic")
    return cornea, aqueous, PotentialFlow(cornea, aqueous, Motion(cornea, aqueous))


def placed(fields, cloud):
    cornea, aqueous, flow = fields
    nodes = cloud.section.cornea_nodes(cloud.wall_count - 1)
    cornea.setup(nodes, **TISSUE, load_shape=np.ones(len(nodes)))
    aqueous.setup(cloud, density=1000.0, viscosity=0.0, sound_speed=80.0, dissipation=0.0)
    flow.setup(cloud)
    flow.refresh()
    return nodes, flow


def two_modes(r, k):
    """A smooth normal velocity that vanishes at the rim and moves no volume: J0 modes with J1(k a) = 0."""
    return j0(k[0] * r) / j0(k[0] * RADIUS) - j0(k[1] * r) / j0(k[1] * RADIUS)


def test_map_of_a_cylinder_is_that_of_bessel_modes(fields):
    k = jn_zeros(1, 2) / RADIUS
    spacings, errors = (0.6e-3, 0.42e-3, 0.3e-3), []
    for spacing in spacings:
        nodes, flow = placed(fields, vessel_cloud(Vessel(RADIUS, DEPTH), spacing))
        flux = two_modes(nodes[:, 0], k) * np.linalg.norm(ring_areas(nodes), axis=1)
        exact = sum(
            sign * j0(kn * nodes[:, 0]) / j0(kn * RADIUS) / (np.tanh(kn * DEPTH) * kn)
            for kn, sign in zip(k, (1.0, -1.0))
        )
        off = flow.neumann @ flux - exact
        errors.append(np.abs(off - off.mean()).max() / np.ptp(exact))
    assert errors[-1] < 0.01
    assert order(spacings, errors) > 1.7


def test_ring_areas_are_the_corneas_own(fields):
    cornea = fields[0]
    nodes, _ = placed(fields, pack(Section(7.8e-3, 5.8e-3, 2.585e-3), 0.4e-3))
    volume = lambda z: np.pi * ((0.5 * (nodes[1:, 0] + nodes[:-1, 0])) ** 2 * (z[:-1] - z[1:])).sum()
    area = ring_areas(nodes)
    for node in (0, 3, len(nodes) - 2):
        lifted = nodes[:, 1].copy()
        lifted[node] += 1e-6
        assert (volume(lifted) - volume(nodes[:, 1])) / 1e-6 == pytest.approx(area[node, 1], rel=1e-9)
    assert not area[-1].any() and area[0, 0] == 0.0
    assert cornea.last[0] == len(nodes) - 1


def test_open_chamber_takes_the_flux_by_a_uniform_source(fields):
    # lap phi = q with q the flux over the volume: constant to rounding where the Laplacian is collocated
    nodes, flow = placed(fields, vessel_cloud(Vessel(RADIUS, DEPTH), 0.42e-3))
    r = nodes[:, 0] / RADIUS
    potential = flow.flow @ ((1.0 - r**2) ** 2 * np.linalg.norm(ring_areas(nodes), axis=1))
    aqueous = fields[1]
    weights = aqueous.operators.laplacian_weight.to_numpy()
    entries, size = aqueous.neighbours.entry.to_numpy(), aqueous.operators.size.to_numpy()
    found = []
    for node in np.flatnonzero(flow.interior):
        row = entries[node, : size[node]]
        found.append(weights[node, : size[node]] @ (potential[np.where(row < 0, -1 - row, row)] - potential[node]))
    assert np.ptp(found) < 1e-6 * np.abs(found).max()


def test_layer_is_the_long_wave_limit(fields):
    # the map of a J0 mode is coth(k H)/k; the layer keeps 1/(k^2 H) + H/3
    for depth in (1e-3, 2e-3):
        nodes = Vessel(RADIUS, depth).cornea_nodes(48)
        cornea = fields[0]
        cornea.setup(nodes, **TISSUE, load_shape=np.ones(len(nodes)))
        layer = LayerFlow(cornea, Vessel(RADIUS, depth))
        layer.refresh()
        k = jn_zeros(1, 2) / RADIUS
        flux = two_modes(nodes[:, 0], k) * np.linalg.norm(ring_areas(nodes), axis=1)
        kept = sum(
            sign * j0(kn * nodes[:, 0]) / j0(kn * RADIUS) * (1.0 / (kn**2 * depth) + depth / 3.0)
            for kn, sign in zip(k, (1.0, -1.0))
        )
        off = (layer.neumann @ flux - kept)[:-1]
        assert np.abs(off - off.mean()).max() < 0.01 * np.ptp(kept)
