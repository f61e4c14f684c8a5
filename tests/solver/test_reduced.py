"""Reduced models: volume, energy, statics, their agreement where physics makes them one, and their stops."""

from pathlib import Path

import numpy as np
import pytest

from taichi_eye.errors import RunStopped
from taichi_eye.ladder.misfit import extrapolate, misfit
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.reduced import BULK_MODULUS

SHORT = ("numerics.duration_ms=18", 'camera.view="scheimpflug"')


def run(model, *overrides, spacing=0.3):
    scene = load_scene(None, (f'numerics.fidelity="{model}"', f"numerics.spacing_mm={spacing}", *SHORT, *overrides))
    simulation = simulation_of(scene)
    simulation.run()
    return simulation


def swept(simulation, frame):
    """Volume [m^3] that the wall has swept by a frame, by the midpoint rule."""
    volumes = []
    for place in (simulation.frames[0], simulation.frames[frame]):
        (r, z), (r1, z1) = place[:-1, :2].T, place[1:, :2].T
        volumes.append((np.pi * (0.5 * (r + r1)) ** 2 * (z - z1)).sum())
    return volumes[0] - volumes[1]


def apex(simulation):
    return simulation.traces["apex_displacement_mm"]


@pytest.mark.parametrize("model", ["membrane", "cavity", "added_mass"])
def test_without_a_puff_nothing_moves(model):
    simulation = run(model, "puff.peak_kpa=0")
    assert np.abs(apex(simulation)).max() < 1e-9
    assert np.abs(simulation.traces["fluid_pressure_apex_kpa"] - 15 * 0.133322387415).max() < 1e-9


@pytest.mark.parametrize("model", ["cavity", "added_mass"])
def test_a_sealed_chamber_yields_by_its_stiffness_alone(model):
    traces = run(model).traces
    rise = (traces["fluid_pressure_apex_kpa"] - traces["fluid_pressure_apex_kpa"][0]) * 1e3
    error = traces["chamber_volume_error"]
    if model == "cavity":
        # a uniform pressure is the mean pressure
        assert error == pytest.approx(-rise / BULK_MODULUS, abs=2e-8)
    assert np.abs(error).max() < 1.5 * rise.max() / BULK_MODULUS


def test_a_globe_that_yields_takes_up_its_compliance_times_the_pressure():
    compliance = 0.4
    simulation = run("cavity", f"chamber.compliance_mm3_mmhg={compliance}")
    traces = simulation.traces
    rise_mmhg = (traces["fluid_pressure_apex_kpa"] - traces["fluid_pressure_apex_kpa"][0]) / 0.133322387415
    # what the wall has swept is what the globe holds: the liquid itself hardly yields
    swept_mm3 = np.array([swept(simulation, frame) for frame in range(len(simulation.wall_mm[0]))]) * 1e9
    at_frames = rise_mmhg[:: simulation.clock.samples_per_frame][: len(swept_mm3)]
    # the multiplier belongs to the start of the last step
    assert swept_mm3 == pytest.approx(compliance * at_frames, abs=0.01 * swept_mm3.max())
    assert np.abs(traces["chamber_volume_error"]).max() < 1e-4
    assert apex(simulation).max() > 1.02 * apex(run("cavity")).max()


@pytest.mark.parametrize("model", ["membrane", "cavity", "added_mass"])
def test_energy_balances_the_closer_the_smaller_the_step(model):
    puff = ("puff.peak_kpa=3",) if model == "membrane" else ()
    errors = []
    for cfl in (0.8, 0.4):
        traces = run(model, f"numerics.cfl={cfl}", *puff).traces
        errors.append(np.abs(traces["energy_error_uj"]).max() / traces["puff_work_uj"].max())
    # of added mass what is left is the ageing of its maps, whatever the step
    assert max(errors) < (5e-4 if model == "added_mass" else 1e-4)
    if model != "added_mass":
        assert errors[1] < 0.8 * errors[0]


def test_cavity_converges_at_second_order():
    coarse, middle, fine = (run("cavity", spacing=h).traces for h in (0.4, 0.2, 0.1))
    steps = [misfit(a, b).history for a, b in ((coarse, middle), (middle, fine))]
    assert steps[0] / steps[1] > 2.0**1.7


def test_a_liquid_without_mass_is_a_uniform_pressure():
    light = run("added_mass", "aqueous.density_kg_m3=1")
    cavity = run("cavity", "aqueous.density_kg_m3=1")
    assert misfit(light.traces, cavity.traces).history < 0.02


def test_an_open_chamber_of_a_massless_liquid_is_a_membrane():
    puff = ("puff.peak_kpa=2", "aqueous.density_kg_m3=1")
    cavity, membrane = run("cavity", "chamber.sealed=false", *puff), run("membrane", *puff)
    assert apex(cavity) == pytest.approx(apex(membrane), abs=1e-12)
    flowing = run("added_mass", "chamber.sealed=false", *puff)
    assert misfit(flowing.traces, membrane.traces).history < 0.02


def test_added_mass_is_the_limit_of_the_resolved_liquid():
    # both extrapolated in h; the resolved one at c = 60 m/s is 0.3 % deep by its compressibility
    exact = extrapolate(run("added_mass", spacing=0.2).traces, run("added_mass", spacing=0.2828).traces, 2.0**0.5)
    liquid = [run("mfpm", "numerics.sound_speed_m_s=60", spacing=h).traces for h in (0.2, 0.2828)]
    found = misfit(extrapolate(*liquid, 2.0**0.5), exact)
    assert found.peak < 0.6 and found.half_times < 0.3 and found.history < 1.0


def test_the_flow_map_may_be_refreshed_seldom():
    often, seldom = (run("added_mass", f"numerics.refresh_travel={travel}") for travel in (0.1, 0.5))
    assert often.refreshes > 2 * seldom.refreshes
    assert misfit(seldom.traces, often.traces).history < 0.5


def test_runs_repeat_to_the_bit_and_are_shown_again_without_another_run():
    first = run("added_mass")
    assert np.array_equal(apex(run("added_mass")), apex(first))
    steps, seen = first.steps, []
    first.run(
        on_frame=lambda simulation, frame: seen.append(
            (frame, simulation.traces["time_ms"][-1], simulation.cornea.place.to_numpy()[0, 1])
        )
    )
    assert first.steps == steps
    times, walls = first.wall_mm
    assert [frame for frame, *_ in seen] == list(range(len(times)))
    assert [time for _, time, _ in seen] == pytest.approx(times)
    assert [z * 1e3 for *_, z in seen] == pytest.approx(walls[:, 0, 1])


@pytest.mark.parametrize(
    "model, overrides, why",
    [
        ("membrane", ("puff.peak_kpa=10",), "reached the back"),
        ("cavity", ("cornea.prestrain=0.002", "cornea.exponent_k=86.1", "puff.peak_kpa=15"), "slack"),
    ],
)
def test_a_run_that_leaves_its_validity_stops_and_keeps_what_was_computed(model, overrides, why):
    scene = load_scene(None, (f'numerics.fidelity="{model}"', "numerics.spacing_mm=0.2", *overrides))
    simulation, seen = simulation_of(scene), []
    with pytest.raises(RunStopped, match=why):
        simulation.run(on_frame=lambda _, frame: seen.append(frame))
    assert 1 < len(simulation.traces["time_ms"]) < simulation.clock.samples
    assert simulation.out_of_validity and seen == list(range(len(simulation.wall_mm[0])))


def test_the_liquid_shown_moves_with_the_wall():
    simulation = run("cavity", spacing=0.3)
    found = []

    def look(shown, frame):
        if frame == 40:
            place, velocity, pressure, count = shown.liquid()
            found.append(
                (
                    velocity.to_numpy()[: shown.wall_count],
                    shown.stepper.shown_velocity.to_numpy()[: shown.wall_count],
                    shown.cornea.place.to_numpy()[: shown.wall_count],
                    pressure.to_numpy()[:count],
                    shown,
                )
            )

    simulation.run(on_frame=look)
    liquid, wall, place, pressure, shown = found[0]
    along = np.gradient(place, axis=0)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    speed = (wall * normal).sum(1)
    inner = slice(1, -3)
    assert (liquid * normal).sum(1)[inner] == pytest.approx(speed[inner], abs=0.05 * np.abs(speed).max())
    assert np.isfinite(pressure).all()


def test_added_mass_stays_sound_where_a_shell_rings_on_after_its_snap():
    """The flow's maps follow the wall's place: a wall that has come back and rings in place ages none of them."""
    healthy = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"
    traces = simulation_of(load_scene(healthy, ("numerics.fidelity=added_mass",))).run()
    work = traces["puff_work_uj"].max()
    assert traces["time_ms"][-1] > 31.9
    assert np.abs(traces["energy_error_uj"]).max() < 2e-3 * work
    assert abs(traces["apex_displacement_mm"][-1]) < 0.01
