"""The figures of a state and the traces of a run: one table for every rung.

A rung measures its state at each sample into a row of QUANTITIES, all SI; what it does not have stays as AT_REST says.
`traces_of` turns the rows into the columns that a user gets, and the guards read the same rows. One meaning of every
column: see COLUMNS.

Energies are relative to rest [J]. What the puff has put in must equal what is stored and moves plus what was lost:
puff_work = stored_energy + lost_energy, up to the error of the scheme.
"""

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np

from taichi_eye.solver.scheme import Clock
from taichi_eye.units import MM, MS

RUNNING, NOT_CONVERGED = 0, 1  # coupling_status

STORED = ("cornea_elastic", "cornea_kinetic", "aqueous_kinetic", "aqueous_elastic")
LOST = ("viscous_loss", "numerical_loss", "outflow_loss", "tissue_loss")
# name -> the value where a rung has no such thing
AT_REST = {
    "apex_place": 0.0,
    "apex_velocity": 0.0,
    "fluid_pressure_apex": 0.0,
    "volume_error": 0.0,
    "puff_work": 0.0,
    "cornea_elastic": 0.0,
    "cornea_kinetic": 0.0,
    "aqueous_kinetic": 0.0,
    "aqueous_elastic": 0.0,
    "viscous_loss": 0.0,
    "numerical_loss": 0.0,
    "outflow_loss": 0.0,
    "tissue_loss": 0.0,
    "least_stress": 0.0,
    "slackest_element": 0.0,
    "membrane_speed": 0.0,
    "transverse_speed": 0.0,
    "steepest_slant": 1.0,
    "slanted_element": 0.0,
    "membrane_step": np.inf,
    "smallest_gap": np.inf,
    "flattest_triangle": 1.0,
    "flat_node": 0.0,
    "pair_weight": 0.0,
    "worst_condition": 1.0,
    "ill_node": 0.0,
    "chamber_gap": 1.0,
    "gap_node": 0.0,
    "not_finite": 0.0,
    "bad_node": -1.0,
    "wall_travel": 0.0,
    "coupling_sweeps": 0.0,
    "coupling_residual": 0.0,
    "coupling_status": float(RUNNING),
}
QUANTITIES = tuple(AT_REST)
at = SimpleNamespace(**{name: column for column, name in enumerate(QUANTITIES)})  # column of a quantity in a row
STORED_COLUMNS = slice(at.cornea_elastic, at.aqueous_elastic + 1)  # of STORED, side by side

# the columns of traces.csv and what they mean, in its order; SI quantities in the units of their names
COLUMNS = {
    "time_ms": "time since the start",
    "apex_displacement_mm": "of the apex along the axis, inward positive",
    "apex_velocity_m_s": "of the apex along the axis, inward positive",
    "puff_apex_kpa": "load on the apex",
    "fluid_pressure_apex_kpa": "pressure of the liquid under the apex, over atmosphere",
    "chamber_volume_error": "volume of the chamber and of what the globe has taken up, less that at rest, over it: by "
    "how much a sealed liquid is compressed; of an open chamber or a constant IOP, what has left",
    "puff_work_uj": "work of the puff since the start",
    "cornea_elastic_uj": "elastic energy of the cornea, membrane and bending, over that at rest",
    "cornea_kinetic_uj": "kinetic energy of the cornea",
    "aqueous_kinetic_uj": "kinetic energy of the liquid",
    "aqueous_elastic_uj": "of the liquid's compression, of the IOP's work and of the globe, over that at rest",
    "viscous_loss_uj": "lost to viscosity since the start",
    "numerical_loss_uj": "lost to the dissipation of the scheme since the start",
    "outflow_loss_uj": "carried off by liquid that left an open chamber since the start",
    "tissue_loss_uj": "lost to relaxing tissue and a late globe since the start",
    "energy_error_uj": "stored and lost, less the work of the puff",
    "coupling_iterations": "sweeps of the coupling, the most of any step since the sample before",
    "coupling_residual": "residual of the coupling, the worst since the sample before",
    "cornea_min_stress_kpa": "smallest principal stress of the cornea in its plane; slack at 0",
}


def at_rest(*shape: int) -> np.ndarray:
    """Rows of figures, [*shape, QUANTITIES], each as AT_REST says."""
    return np.tile(np.array(list(AT_REST.values())), (*shape, 1))


def stored_energy(figures: Mapping[str, np.ndarray]):
    """Energy [J] in cornea, liquid and globe relative to rest."""
    return sum(figures[name] for name in STORED)


def lost_energy(figures: Mapping[str, np.ndarray]):
    """Energy [J] lost or carried off since the start."""
    viscous, numerical, outflow, tissue = (figures[name] for name in LOST)
    return viscous + numerical + outflow + tissue


def traces_of(rows: np.ndarray, clock: Clock, puff, apex_z: float) -> dict[str, np.ndarray]:
    """The traces, an array for each of COLUMNS, of rows of figures [samples, QUANTITIES].

    puff: the eye's; apex_z: height of the apex at rest [m].
    """
    figures = dict(zip(QUANTITIES, rows.T))
    time_ms = clock.times_ms(len(rows))
    energies = ("puff_work", *STORED, *LOST)
    found = {
        "time_ms": time_ms,
        "apex_displacement_mm": (apex_z - figures["apex_place"]) / MM,
        "apex_velocity_m_s": -figures["apex_velocity"],
        "puff_apex_kpa": puff.pressure_at_apex(time_ms * MS) * 1e-3,
        "fluid_pressure_apex_kpa": figures["fluid_pressure_apex"] * 1e-3,
        "chamber_volume_error": figures["volume_error"].copy(),
        **{f"{name}_uj": figures[name] * 1e6 for name in energies},
        "energy_error_uj": (stored_energy(figures) + lost_energy(figures) - figures["puff_work"]) * 1e6,
        "coupling_iterations": figures["coupling_sweeps"].copy(),
        "coupling_residual": figures["coupling_residual"].copy(),
        "cornea_min_stress_kpa": figures["least_stress"] * 1e-3,
    }
    return {name: found[name] for name in COLUMNS}
