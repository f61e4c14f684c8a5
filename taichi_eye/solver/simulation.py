"""A scene's coupled simulation: built from the scene, run sample by sample, watched by the guards.

Time is cut into film frames, frames into samples of at most `SAMPLE_MS`, samples into equal steps below the stable
limit of the moment. At each sample the traces grow by a row, the guards look, and the operator weights are rebuilt once
the wall has moved by `numerics.refresh_travel` spacings since they were last.
"""
import math
from dataclasses import asdict
from typing import Callable

import numpy as np

from taichi_eye.cloud.packing import Cloud, pack
from taichi_eye.cloud.quality import CloudQuality, measure
from taichi_eye.errors import SceneError
from taichi_eye.eye.puff import Puff
from taichi_eye.eye.section import Section
from taichi_eye.eye.thickness import prestrain, thickness
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.solver import guards, timestep
from taichi_eye.solver.workspace import borrow
from taichi_eye.units import MM, MM3, MMHG, MPA_S, MS

SAMPLE_MS = 0.025  # longest time between two rows of the traces


def cloud_of(scene) -> Cloud:
    """The packed node cloud of a resolved scene; SceneError where its chamber cannot be filled at its spacing."""
    return pack(Section.from_scene(scene), scene.numerics.spacing_mm * MM)


class Simulation:
    """One scene's coupled cornea and aqueous humour.

    scene: resolved; cloud: its `cloud_of`, packed here when left out (SceneError where that fails). Public: cornea, aqueous (fields), section, cloud, quality, traces (dict of lists), step_limit (the
    limit that set the last time step), steps (taken so far), rebuilds.
    """

    def __init__(self, scene, cloud: Cloud | None = None):
        self.scene = scene
        self.puff = Puff.from_scene(scene)
        numerics = scene.numerics
        self.cloud = cloud or cloud_of(scene)
        self.section = self.cloud.section
        self.quality: CloudQuality = measure(self.cloud)
        workspace = borrow(self, self.cloud.count, self.cloud.wall_count, numerics.basis)
        self.cornea, self.aqueous, self.coupling = workspace.cornea, workspace.aqueous, workspace.coupling
        self.motion, self.survey = workspace.motion, workspace.survey
        self._place_at_rest()
        frame = scene.camera.frame_interval_ms
        self.samples_per_frame = max(1, math.ceil(frame / SAMPLE_MS - 1e-9))
        self.sample_ms = frame / self.samples_per_frame
        self.samples = int(math.floor(numerics.duration_ms / self.sample_ms + 1e-9))
        self.traces: dict[str, list[float]] = {}
        self.sample = self.steps = self.rebuilds = 0
        self._dt = 0.0
        self._largest_work = 0.0
        self.step_limit = ""

    def _place_at_rest(self) -> None:
        scene, cornea, numerics = self.scene, self.scene.cornea, self.scene.numerics
        nodes = self.section.cornea_nodes(self.cloud.wall_count - 1)
        s = cornea.exponent_k / (1.0 + cornea.poisson_ratio)
        middle = 0.5 * (nodes[1:, 0] + nodes[:-1, 0])
        self.cornea.setup(nodes, thickness(scene, middle), cornea.density_kg_m3,
                          (cornea.stiffness_a_pa, s, cornea.poisson_ratio, prestrain(scene, middle)),
                          scene.eye.iop_mmhg * MMHG, self.puff.radial(nodes[:, 0]), cornea.flexural_modulus_mpa * 1e6)
        self.aqueous.setup(self.cloud, scene.aqueous.density_kg_m3, scene.aqueous.viscosity_mpa_s * MPA_S,
                           numerics.sound_speed_m_s, numerics.dissipation, numerics.wall_condition == "no_slip",
                           scene.chamber.sealed)
        self.aqueous.compliance[None] = scene.chamber.compliance_mm3_mmhg * MM3 / MMHG
        self.coupling.setup(numerics.coupling == "iterated", numerics.relaxation == "aitken",
                            numerics.relaxation_factor, numerics.coupling_tolerance, numerics.coupling_iterations_max)
        self.survey.remember_rest(self.section.back_height(nodes[:, 0]))
        figures = self.survey.take()
        limit = CONDITION_LIMIT[numerics.basis]
        if not figures["worst_condition"] <= limit:
            where = self.cloud.points[int(figures["ill_node"]), 0] / MM
            raise SceneError(f"cornea.radius_mm = {cornea.radius_mm:g}, cornea.limbus_radius_mm = {cornea.limbus_radius_mm:g}, "
                             f'numerics.basis = "{numerics.basis}": the stencil at r = {where:.2f} mm has a condition number '
                             f"of {figures['worst_condition']:.1e}, at most {limit:.0e} is allowed; the wedge at the limbus is "
                             "too sharp for the basis: bring the limbus radius nearer to the cornea's, or use \"quadratic\"")

    @property
    def time_ms(self) -> float:
        """Simulated time of the last sample."""
        return self.sample * self.sample_ms

    @property
    def wall_count(self) -> int:
        """Nodes of the cornea."""
        return self.cloud.wall_count

    def liquid(self):
        """Fields of the liquid now: place, velocity, excess pressure, and how many nodes they hold."""
        return self.aqueous.place, self.aqueous.velocity, self.aqueous.pressure, self.cloud.count

    def facts(self) -> dict:
        """What a summary tells about the discretisation and the work done."""
        condition = float(self.aqueous.operators.condition.to_numpy()[:self.cloud.count].max())
        sweeps = np.array(self.traces["coupling_iterations"])
        return {
            "coupling_iterations": {"mean": float(sweeps[1:].mean()) if len(sweeps) > 1 else 0.0, "most": int(sweeps.max())},
            "cloud": {**asdict(self.quality), "wall_nodes": self.wall_count, "worst_stencil_condition": condition},
            "steps": self.steps, "step_limit": self.step_limit, "operator_rebuilds": self.rebuilds}

    def about(self) -> str:
        """The model of the liquid in a line."""
        quality, numerics = self.quality, self.scene.numerics
        return (f"{quality.nodes} nodes at {numerics.spacing_mm:g} mm ({numerics.basis}), smallest gap "
                f"{quality.smallest_gap:.2f} and largest hole {quality.largest_hole:.2f} spacings, "
                f"c {numerics.sound_speed_m_s:g} m/s")

    def run(self, on_frame: Callable[["Simulation", int], None] | None = None,
            on_sample: Callable[["Simulation"], None] | None = None) -> dict[str, np.ndarray]:
        """Run to the end; call on_frame(self, frame) at each film frame and on_sample(self) at each sample.

        Returns the traces as arrays. Raises RunStopped when a guard stops the run; `traces` keeps what was computed.
        """
        frames = self.scene.camera.frame_count
        figures = self._record()
        while True:
            frame, rest = divmod(self.sample, self.samples_per_frame)
            if on_sample:
                on_sample(self)
            if rest == 0 and frame < frames and on_frame:
                on_frame(self, frame)
            if self.sample >= self.samples:
                break
            figures = self._next_sample(figures)
        return self.arrays()

    def arrays(self) -> dict[str, np.ndarray]:
        """The traces so far, one array per column."""
        return {name: np.array(column) for name, column in self.traces.items()}

    def _next_sample(self, figures):
        limit, self.step_limit = timestep.stable_step(figures, self.scene)
        span = self.sample_ms * MS
        steps = math.ceil(span / limit)
        dt = span / steps
        start = self.sample * span
        times = start + dt * np.arange(1, steps + 1)
        self.coupling.advance(self.puff.pressure_at_apex(times), dt, self._dt or dt)
        self._dt = dt
        self.steps += steps
        self.sample += 1
        return self._record()

    def _record(self):
        self.motion.move_nodes()
        figures = self.survey.take()
        stored = sum(figures[name] for name in ("cornea_elastic", "cornea_kinetic", "aqueous_kinetic",
                                                "aqueous_elastic"))
        lost = figures["viscous_loss"] + figures["numerical_loss"] + figures["outflow_loss"]
        energy_error = stored + lost - figures["puff_work"]
        self._largest_work = max(self._largest_work, abs(figures["puff_work"]))
        row = {
            "time_ms": self.time_ms,
            "apex_displacement_mm": (self.section.apex_z - figures["apex_place"]) / MM,
            "apex_velocity_m_s": -figures["apex_velocity"],
            "puff_apex_kpa": float(self.puff.pressure_at_apex(self.time_ms * MS)) * 1e-3,
            "fluid_pressure_apex_kpa": figures["fluid_pressure_apex"] * 1e-3,
            "chamber_volume_error": figures["volume_error"],
            **{f"{name}_uj": figures[name] * 1e6 for name in
               ("puff_work", "cornea_elastic", "cornea_kinetic", "aqueous_kinetic", "aqueous_elastic", "viscous_loss",
                "numerical_loss", "outflow_loss")},
            "energy_error_uj": energy_error * 1e6,
            "coupling_iterations": figures["coupling_sweeps"],
            "coupling_residual": figures["coupling_residual"],
            "cornea_min_stress_kpa": figures["least_stress"] * 1e-3,
        }
        guards.check(figures, stored - figures["puff_work"], self._largest_work, self.scene,
                     lambda node: float(self.cloud.points[node, 0]) / MM, self.time_ms, figures["viscous_loss"],
                     figures["numerical_loss"])
        for name, value in row.items():
            self.traces.setdefault(name, []).append(value)
        if figures["wall_travel"] > self.scene.numerics.refresh_travel * self.cloud.spacing:
            self.aqueous.rebuild()
            self.survey.remember_build()
            self.rebuilds += 1
        return figures
