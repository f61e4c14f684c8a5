"""Spectrum: largest growth rate of the coupled semi-discrete system about rest, from the solver's own step.

`taichi_eye.proof.spectrum` takes one small step of the solver about rest as a matrix, column by column through the
actual kernels; its eigenvalues over that step are the semi-discrete spectrum. Theory: plain collocation between walls
is unstable whatever the time step; a fourth-difference dissipation of p and u lifts that where the cloud has no gaps.
1e-4 c/h is what a puff of 32 ms does not notice.
"""

import numpy as np

from taichi_eye.cloud.packing import FREE, Cloud, complete
from taichi_eye.eye.eye import eye_of
from taichi_eye.proof.maps.result import Map, finish, panels
from taichi_eye.proof.maps.runs import cloud_for, scene_with
from taichi_eye.proof.spectrum import CoupledSystem, growth, step_matrix
from taichi_eye.report.page import COLOURS
from taichi_eye.solver.scheme import scheme_of
from taichi_eye.units import MM

ACCEPTED = 1e-4  # c/h
SMALL_CFL = 0.05  # time step of the spectra, in h/c
SPACING_MM, SPEED = 0.45, 80.0
DISSIPATION = (0.0, 0.1, 0.2, 0.3, 0.5)


def eye_setup(scene, **more) -> dict:
    """What `CoupledSystem.setup` takes for the eye of a scene."""
    eye, scheme = eye_of(scene), scheme_of(scene)
    setup = {
        "thickness": eye.cornea.thickness,
        "wall_density": eye.cornea.density,
        "iop": eye.iop,
        "material": (*eye.cornea.coefficients, eye.apex_prestrain),
        "density": eye.liquid.density,
        "viscosity": eye.liquid.viscosity,
        "sound_speed": scheme.sound_speed,
        "dissipation": scheme.dissipation,
    }
    return {**setup, **more}


def jittered(cloud: Cloud, share: float, seed: int = 1) -> Cloud:
    """The cloud with its inner nodes moved at random by up to `share` spacings either way."""
    points = cloud.points.copy()
    inner = cloud.kind == FREE
    move = np.random.default_rng(seed).uniform(-share, share, (int(inner.sum()), 2)) * cloud.spacing
    moved = points[inner] + move
    moved[:, 0] = np.maximum(moved[:, 0], 0.2 * cloud.spacing)
    inside = cloud.section.wall_clearance(moved) > 0.2 * cloud.spacing
    points[inner] = np.where(inside[:, None], moved, points[inner])
    return _again(cloud, points, np.ones(cloud.count, dtype=bool))


def without_node_under_wall(cloud: Cloud) -> Cloud:
    """The cloud without the inner node nearest to the middle of the cornea."""
    distance = np.linalg.norm(cloud.points - cloud.points[cloud.wall_count // 2], axis=1)
    keep = np.ones(cloud.count, dtype=bool)
    keep[np.argmin(np.where(cloud.kind == FREE, distance, np.inf))] = False
    return _again(cloud, cloud.points, keep)


def _again(cloud, points, keep):
    boundary = int((cloud.kind != FREE).sum())
    return complete(
        cloud.section, cloud.spacing, points[keep], cloud.kind[:boundary], cloud.direction[:boundary], cloud.wall_count
    )


def spectrum(say=print) -> Map:
    """Growth rate against dissipation for bases, neighbour counts and cloud qualities."""
    scene = scene_with({"numerics.spacing_mm": SPACING_MM, "numerics.sound_speed_m_s": SPEED})
    packed = cloud_for(scene)
    unit = SPEED / (SPACING_MM * MM)
    dt = SMALL_CFL / unit
    variants = [
        ("packed, quadratic, 14 neighbours", "quadratic", 14, packed),
        ("packed, quadratic, 10", "quadratic", 10, packed),
        ("packed, quadratic, 20", "quadratic", 20, packed),
        ("packed, cubic, 24", "cubic", 24, packed),
        *(
            (f"jittered {100 * share:.0f} %, quadratic, 14", "quadratic", 14, jittered(packed, share))
            for share in (0.05, 0.2, 0.4)
        ),
        ("one node removed under the wall", "quadratic", 14, without_node_under_wall(packed)),
    ]
    systems = {basis: CoupledSystem(packed.count, packed.wall_count, basis=basis) for basis in ("quadratic", "cubic")}
    rates = {}
    for name, basis, stencil, cloud in variants:
        rates[name] = []
        for alpha in DISSIPATION:
            systems[basis].setup(cloud, stencil=stencil, **eye_setup(scene, dissipation=alpha))
            rates[name].append(growth(step_matrix(systems[basis], dt), dt) / unit)
        say(f"  {name}: " + "  ".join(f"{rate:.1e}" for rate in rates[name]))
    canvas, ((left, right),) = panels(2)
    for k, (name, row) in enumerate(rates.items()):
        axes = left if k < 4 else right
        axes.plot(DISSIPATION, np.maximum(row, 1e-8), "o-", color=COLOURS[k % len(COLOURS)], markersize=4, label=name)
    right.plot(
        DISSIPATION, np.maximum(rates[variants[0][0]], 1e-8), "o-", color="#22262b", markersize=4, label=variants[0][0]
    )
    for axes, title in ((left, "basis and neighbours"), (right, "cloud quality")):
        axes.axhline(ACCEPTED, color="#22262b", linestyle=":", linewidth=1, label="accepted: 1e-4 c/h")
        axes.axvline(0.5, color="#8a9199", linewidth=1, label="default dissipation")
        finish(
            axes,
            f"{title}, h {SPACING_MM:g} mm, c {SPEED:g} m/s",
            "dissipation (c h); 0 is the naive scheme",
            "largest growth rate (c/h)",
            log="y",
            legend="upper right",
        )
        axes.set_ylim(5e-9, 30.0)
    default, at = rates[variants[0][0]], DISSIPATION.index(0.5)
    worst = max(rates, key=lambda name: rates[name][at])
    found = [
        "The default (packed, quadratic, 14 neighbours, dissipation 0.5): fastest growing mode "
        f"{default[at]:.1e} c/h, accepted "
        f"{ACCEPTED:g}.",
        f"The naive scheme, no dissipation, grows at {default[0]:.2g} c/h: it fails within "
        f"{20 / (default[0] * unit) * 1e3:.1g} "
        "ms whatever the time step.",
        f'At dissipation 0.5 the worst variant is "{worst}": {rates[worst][at]:.1e} c/h.',
    ]
    broken = [] if default[at] <= ACCEPTED else [f"the default settings grow at {default[at]:.1e} c/h"]
    body = [(name, *(f"{rate:.1e}" for rate in row)) for name, row in rates.items()]
    return Map(
        "spectrum",
        canvas,
        found,
        ("cloud and stencil", *(f"dissipation {a:g}" for a in DISSIPATION)),
        body,
        {"dissipation": DISSIPATION, "growth_c_per_h": rates},
        broken,
    )
